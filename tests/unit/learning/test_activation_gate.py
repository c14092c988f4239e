"""The gate lets nothing through that could be chance, one phone's word, or a loss of names."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.learning.activation.answer import DeviceTrial, Trial, pooled, read_answer
from services.learning.activation.gate import Gate, GateSettings
from services.learning.proposal import Proposal
from shared.messages import RadioModelUpdate

GATE = Gate()
WANTED = GateSettings()
PROPOSAL = Proposal("radio", "hall", "hall", RadioModelUpdate(t=0.0, area="hall", version=0), 0.0, b"{}")


def trial(gains: list[float], error: float | None = 0.002, scans: int = 100, **changes: object) -> Trial:
    fields = {
        "scans": scans * len(gains),
        "seconds": 240.0,
        "gain": sum(gains) / len(gains) if gains else 0.0,
        "gain_error": error,
        "active_named": 0.7,
        "candidate_named": 0.71,
        "devices": {f"d-{row}": DeviceTrial(scans=scans, gain=gain) for row, gain in enumerate(gains)},
    }
    return Trial(**{**fields, **changes})  # type: ignore[arg-type]


def outcome(one: Trial, *more: Trial) -> tuple[str, str]:
    ruling = GATE.of_trials(PROPOSAL, [one, *more])
    return ruling.outcome, ruling.reason


def test_a_candidate_that_wins_on_all_phones_goes_live_and_the_reason_says_by_how_much() -> None:
    ruling = GATE.of_trials(PROPOSAL, [trial([0.05, 0.04, 0.06])])
    assert ruling.outcome == "activate"
    assert "wins by 0.05 nats per reading" in ruling.reason
    assert ruling.evidence["phones heard"] == 3.0


@pytest.mark.parametrize(
    ("answer", "expected", "words"),
    [
        (trial([-0.01, -0.02]), "refuse", "not more than"),
        (trial([0.9, -0.001, 0.0]), "refuse", "one phone alone carries the gain"),
        (trial([0.3, 0.3, -0.2]), "refuse", "one phone would be worse off by 0.2"),
        (trial([0.05, 0.04], candidate_named=0.6), "refuse", "names would be lost: 10.0 %"),
        (trial([0.05, 0.04], tracks_gain=-0.02, tracks_gain_error=0.01), "refuse", "names would be worse: 0.02 nats"),
        (trial([0.05, 0.04], tracks_gain=-0.02, tracks_gain_error=0.03), "activate", "wins by"),
        (trial([0.05], error=None), "later", "too little held-out data: 100 scans"),
        (trial([0.05], error=None, scans=200), "refuse", "one phone alone was heard"),
        (trial([0.005], error=0.002, scans=200), "more", "not surely"),
        (trial([0.05], scans=200), "activate", "wins by"),
        (trial([0.05, 0.05], scans=5), "later", "too little held-out data: 10 scans"),
        (trial([0.05, 0.05], seconds=30.0), "later", "30 s"),
        (trial([0.05, 0.05], gain=None), "later", "scored no candidate"),
        (Trial(error="busy: another candidate is being tried; ask again later"), "later", "busy"),
        (Trial(error="scans: found 3 to withhold"), "later", "scans"),
        (Trial(error="shadowing.cell: found 0; allowed: 0.1 … 10"), "refuse", "fusion cannot try it: shadowing.cell"),
    ],
)
def test_what_does_not_convince_is_refused_or_waits_and_says_why(answer: Trial, expected: str, words: str) -> None:
    found, reason = outcome(answer)
    assert found == expected
    assert words in reason
    assert "d-0" not in reason  # reasons are kept, phones may withdraw


def test_what_is_better_but_not_surely_is_tried_on_more_time_and_then_decided() -> None:
    unsure = trial([0.006, 0.005, 0.004], error=0.007)
    assert outcome(unsure)[0] == "more"
    assert outcome(unsure, unsure)[0] == "more"
    assert outcome(unsure, unsure, unsure, unsure)[0] == "activate"  # 0.005 against 1.25 * 0.007 / 2
    once = trial([0.006, 0.007, 0.0065], error=0.004)
    assert outcome(once)[0] == "more"  # 1.6 standard errors are not enough for one look
    assert outcome(once, once)[0] == "activate"
    assert outcome(*[trial([0.0021, 0.002], error=0.004)] * WANTED.looks)[0] == "refuse"
    chance = trial([0.0031, 0.003], error=0.01)
    assert outcome(chance)[0] == "more"
    assert outcome(chance, chance)[0] == "refuse"  # 0.4 standard errors after two looks: it is not worth the wait


def test_a_change_that_was_noticed_before_counts_as_a_look() -> None:
    once = trial([0.006, 0.007, 0.0065], error=0.004)
    assert outcome(once)[0] == "more"
    assert GATE.of_trials(dataclasses.replace(PROPOSAL, urgent=True), [once]).outcome == "activate"


def test_later_time_that_speaks_against_a_candidate_refuses_it() -> None:
    assert outcome(trial([0.006, 0.005], error=0.004), trial([-0.02, -0.03], error=0.004))[0] == "refuse"


def test_pooled_trials_count_by_their_scans() -> None:
    both = pooled([trial([0.1, 0.1], error=0.02, scans=100), trial([0.0], error=0.01, scans=200)])
    assert both.scans == 400
    assert both.seconds == 480.0
    assert both.gain == pytest.approx(0.05)
    assert both.tracks_gain_error is None
    assert both.gain_error == pytest.approx(math.hypot(0.02 * 200, 0.01 * 200) / 400)
    assert both.devices["d-0"] == DeviceTrial(scans=300, gain=pytest.approx(0.1 / 3))
    with pytest.raises(ValueError, match="tried nothing"):
        pooled([Trial(error="busy")])


@given(
    gains=st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=6),
    error=st.none() | st.floats(0.0, 1.0),
    scans=st.integers(0, 400),
    named=st.floats(0.0, 1.0),
)
def test_nothing_goes_live_without_the_margin(
    gains: list[float], error: float | None, scans: int, named: float
) -> None:
    answer = trial(gains, error, scans, candidate_named=named)
    ruling = GATE.of_trials(PROPOSAL, [answer])
    assert ruling.outcome in ("activate", "refuse", "later", "more")
    assert ruling.reason
    if ruling.outcome != "activate":
        return
    spread = answer.spread
    assert spread is not None
    assert answer.gain is not None
    assert answer.gain > max(WANTED.least_gain, WANTED.errors * spread)
    assert answer.scans >= WANTED.least_scans
    assert named >= answer.active_named - WANTED.names - 1e-12
    assert min(gains) >= -WANTED.ruined or scans < WANTED.heard


@given(
    gains=st.lists(st.floats(-0.05, 0.2), min_size=2, max_size=5),
    error=st.floats(0.0, 0.1),
    more=st.floats(0.0, 0.3),
)
def test_what_goes_live_would_with_a_larger_gain_of_everybody_or_less_doubt(
    gains: list[float], error: float, more: float
) -> None:
    if outcome(trial(gains, error))[0] == "activate":
        assert outcome(trial([gain + more for gain in gains], error))[0] == "activate"
        assert outcome(trial(gains, error / (1.0 + more)))[0] == "activate"


@pytest.mark.parametrize(
    ("gain", "margin", "expected"),
    [
        (0.2, 0.1, "activate"),
        (0.1, 0.1, "refuse"),
        (-1.0, 0.1, "refuse"),
        (None, 0.1, "refuse"),
        (0.2, None, "refuse"),
        (math.nan, 0.1, "refuse"),
        (0.2, 0.0, "refuse"),
        (math.inf, 0.1, "refuse"),
    ],
)
def test_a_learner_that_scored_its_candidate_itself_is_held_to_its_margin(
    gain: float | None, margin: float | None, expected: str
) -> None:
    proposal = Proposal("heading", "d-1", "hall", PROPOSAL.model, 0.0, gain=gain, margin=margin)
    assert GATE.of_its_own(proposal).outcome == expected


def test_an_answer_that_is_none_tries_nothing() -> None:
    assert "not understood" in (read_answer({"gain": "much"}).error or "")
    assert read_answer({"gain": 0.1, "scans": 70, "new": 1}).gain == 0.1


def test_without_an_error_from_fusion_the_phones_disagreement_is_one() -> None:
    assert trial([0.1, 0.1], error=None).spread == pytest.approx(0.0)
    assert (trial([0.2, 0.0], error=None).spread or 0.0) > 0.05
    assert trial([0.2], error=None).spread is None
