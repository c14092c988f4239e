"""Choosing detector options by score: the top of a noisy curve, and no change for less than noise."""

import math
from collections.abc import Callable, Mapping

import numpy as np
import pytest

from services.learning.cameras.detector_choice import RATES, SWEEPS, DetectorChoice, choose_detector
from shared.messages import DetectorSettings

ACTIVE = {"learning_rate": 0.01, "sensitivity": 16.0}
RATE_ONLY = SWEEPS[:1]


def hill(top: float, noise: float, seed: int, high: float = 100.0) -> Callable[[Mapping[str, float]], float]:
    """A score that falls on both sides of a learning rate, by half within a decade and a half."""
    rng = np.random.default_rng(seed)

    def score(options: Mapping[str, float]) -> float:
        off = math.log10(options["learning_rate"] / top)
        return high / (1.0 + (off / 1.5) ** 2) + noise * float(rng.standard_normal())

    return score


def told(
    score: Callable[[Mapping[str, float]], float | None],
) -> Callable[[Mapping[str, float], Mapping[str, float]], dict[str, float] | None]:
    def tell(options: Mapping[str, float], best: Mapping[str, float]) -> dict[str, float] | None:
        value = score(options)
        return None if value is None else {"cqs": value}

    return tell


def choose(score: Callable[[Mapping[str, float]], float | None], active: float = 0.01) -> DetectorChoice:
    return choose_detector({"learning_rate": active}, dict, told(score), RATE_ONLY)


@pytest.mark.parametrize("top", [0.003, 0.03, 0.2])
def test_the_top_of_the_curve_is_found_with_few_trials(top: float) -> None:
    asked: list[float] = []

    def redetect(options: Mapping[str, float]) -> Mapping[str, float]:
        asked.append(options["learning_rate"])
        return dict(options)

    active = 1.0 if top < 0.1 else 0.003
    choice = choose_detector({"learning_rate": active}, redetect, told(hill(top, 1.0, 1)), RATE_ONLY)
    assert 0.5 < choice.options["learning_rate"] / top < 2.0
    assert choice.gain > choice.margin > 0.0
    assert len(asked) == len(set(asked)) <= 14
    assert min(asked) <= RATES[0]


def test_noise_alone_rarely_changes_anything() -> None:
    changed = [bool(choose(hill(0.01, 5.0, seed)).options) for seed in range(60)]
    assert sum(changed) <= 3
    flat = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        flat.append(bool(choose(lambda _, rng=rng: 50.0 + 5.0 * rng.standard_normal()).options))  # type: ignore[misc]
    assert sum(flat) <= 6


def test_a_clear_gain_is_taken_in_spite_of_noise() -> None:
    taken = [choose(hill(0.1, 3.0, seed), active=0.003).options.get("learning_rate", 0.0) for seed in range(40)]
    assert sum(0.03 < rate < 0.3 for rate in taken) >= 32


def test_a_second_option_is_swept_about_the_winner() -> None:
    asked: list[Mapping[str, float]] = []

    def score(options: Mapping[str, float]) -> float:
        asked.append(options)
        rate, sensitivity = (
            math.log(options[name] / best) for name, best in (("learning_rate", 0.1), ("sensitivity", 24.0))
        )
        return 100.0 - 4.0 * rate**2 - 60.0 * sensitivity**2

    choice = choose_detector(ACTIVE, dict, told(score))
    assert choice.options["learning_rate"] == pytest.approx(0.1, rel=0.2)
    assert choice.options["sensitivity"] == pytest.approx(24.0, rel=0.2)
    other = [options for options in asked if options["sensitivity"] != 16.0]
    assert {options["learning_rate"] for options in other} == {choice.options["learning_rate"]}


def test_what_cannot_be_tried_is_left_out_and_nothing_is_said_without_the_active_ones() -> None:
    choice = choose_detector(
        ACTIVE,
        lambda options: None if options["sensitivity"] != 16.0 or options["learning_rate"] > 0.5 else dict(options),
        told(hill(0.1, 0.0, 1)),
    )
    assert set(choice.options) == {"learning_rate"}
    assert choose_detector(ACTIVE, lambda _: None, told(lambda _: 1.0)).refused
    assert choose_detector(ACTIVE, dict, told(lambda _: math.nan)).refused
    assert choose_detector(ACTIVE, dict, lambda *_: None).proposal("door", "hall", 1.0, {}) is None
    with pytest.raises(ValueError, match="sensitivity"):
        choose_detector({"learning_rate": 0.1}, dict, told(lambda _: 1.0))


def test_the_proposal_carries_the_whole_curve_and_keeps_what_was_not_swept() -> None:
    choice = choose(hill(0.1, 0.5, 3), active=0.003)
    proposal = choice.proposal("door", "hall", 1000.0, {"least_gain": 0.2, "learning_rate": 0.003})
    assert proposal is not None
    assert isinstance(proposal.model, DetectorSettings)
    assert proposal.model.options == {"least_gain": 0.2, **choice.options}
    assert (proposal.kind, proposal.subject, proposal.area) == ("detector", "door", "hall")
    assert len(proposal.evidence) == len(choice.curves[0].value) >= len(RATES)
    assert proposal.gain is not None
    assert proposal.margin is not None
    assert proposal.gain > proposal.margin
    assert "0.003 →" in proposal.reason


@pytest.mark.parametrize(("error", "taken"), [(1.0, True), (60.0, False)])
def test_a_gain_that_minutes_do_not_agree_about_is_not_taken(error: float, taken: bool) -> None:
    rate = hill(0.1, 0.0, 1)

    def score(options: Mapping[str, float], best: Mapping[str, float]) -> dict[str, float]:
        return {"cqs": rate(options), "error": error}

    choice = choose_detector({"learning_rate": 0.003}, dict, score, RATE_ONLY)
    assert bool(choice.options) is taken
    assert choice.margin >= (2.0 * error if taken else 0.0)


SMALLER = {"height_scale": 0.94, "height_scale_right": 0.0, "height_scale_down": 0.08, "width_scale": 0.85}


@pytest.mark.parametrize(("worth", "error", "taken"), [(6.0, 1.0, True), (6.0, 4.0, False), (1.0, 0.1, False)])
def test_measured_sizes_are_taken_if_they_are_surely_better(worth: float, error: float, taken: bool) -> None:
    def score(options: Mapping[str, float], best: Mapping[str, float]) -> dict[str, float]:
        return {"cqs": 100.0 + worth * ("height_scale" in options), "error": error}

    choice = choose_detector({"learning_rate": 0.01}, dict, score, RATE_ONLY, SMALLER)
    assert choice.options == (SMALLER if taken else {})
    assert choice.sizes == SMALLER
    assert choice.sized == {"in use": 100.0, "measured": 100.0 + worth}
    proposal = choice.proposal("door", "hall", 1000.0, {"least_gain": 0.2})
    assert (proposal is not None) is taken
    if proposal is not None:
        assert isinstance(proposal.model, DetectorSettings)
        assert proposal.model.options == {"least_gain": 0.2, **SMALLER}
        assert proposal.evidence["score with sizes measured"] == 106.0
        assert "6 % smaller" in proposal.reason
        assert proposal.gain == 6.0
        assert proposal.gain > (proposal.margin or 0.0)


def test_measured_sizes_are_held_against_the_best_of_the_other_options() -> None:
    rate = hill(0.1, 0.0, 1)
    for worth, taken in ((20.0, True), (-3.0, False)):

        def score(options: Mapping[str, float], best: Mapping[str, float], worth: float = worth) -> dict[str, float]:
            return {"cqs": rate(options) + worth * ("height_scale" in options), "error": 1.0}

        choice = choose_detector({"learning_rate": 0.003}, dict, score, RATE_ONLY, SMALLER)
        assert choice.options["learning_rate"] == pytest.approx(0.1, rel=0.5)
        assert (choice.options.keys() >= SMALLER.keys()) is taken


@pytest.mark.parametrize(("worth", "taken"), [(9.0, False), (30.0, True)])
@pytest.mark.parametrize("option", ["sensitivity", "height_scale"])
def test_nothing_rides_on_the_gain_of_what_won_before(option: str, worth: float, taken: bool) -> None:
    rate = hill(0.1, 0.0, 1, high=200.0)

    def score(options: Mapping[str, float], best: Mapping[str, float]) -> dict[str, float]:
        wide = (math.log(options["sensitivity"] / 24.0) / math.log(1.5)) ** 2
        second = {"sensitivity": max(1.0 - wide, -1.0), "height_scale": float("height_scale" in options)}[option]
        # As fusion: the more two detectors differ, the less sure is by how much one is better.
        near = abs(math.log(options["learning_rate"] / best["learning_rate"])) < 0.1
        return {"cqs": rate(options) + worth * second, "error": 8.0 if near else 10.0}

    sizes = SMALLER if option == "height_scale" else None
    choice = choose_detector({"learning_rate": 0.001, "sensitivity": 16.0}, dict, score, SWEEPS, sizes)
    assert choice.options["learning_rate"] == pytest.approx(0.1, rel=0.5)
    assert (option in choice.options) is taken
    assert choice.gain > choice.margin >= (36.0 if taken else 20.0)


def test_sizes_that_cannot_be_tried_change_nothing() -> None:
    choice = choose_detector(
        {"learning_rate": 0.01},
        lambda options: None if "height_scale" in options else dict(options),
        told(lambda _: 50.0),
        RATE_ONLY,
        SMALLER,
    )
    assert (choice.options, choice.sizes, choice.refused) == ({}, {}, "")
