"""From errors to the figures of learning: relative steps, recovery that lasts, what the gate let in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fusion_world import World, make_site

from benchmarks.learning_candidates import KINDS, poisoned
from benchmarks.learning_figures import ladder_figures, lesson_figures, rate_figures
from benchmarks.learning_gate import EACH, WORLDS, Bout, change_of, draw_gate, gate_figures
from benchmarks.learning_ladder import RATES, STAGES, TRACKERS, Climb, RateCurve, Rung
from benchmarks.learning_picture import draw_learning
from benchmarks.learning_recovery import CHANGED, WINDOW, Recovery, draw_recovery, recovery_figures
from benchmarks.learning_speed import shifted
from benchmarks.world_record import Truth, WorldRecord
from benchmarks.world_run import load
from shared.messages import MotionBatch, RadioScan

BEFORE = round(CHANGED / WINDOW)


def rung(scale: float) -> Rung:
    errors = {stage: scale * 0.8**number * np.arange(1.0, 11.0) for number, stage in enumerate(STAGES)}
    # The sum tells less of the error than the rate: a minute told in part has less of everything.
    rate, seconds, rmse = -np.arange(5.0), np.array([60.0, 60.0, 60.0, 60.0, 20.0]), np.arange(5.0)
    minutes = np.column_stack([rate * seconds, seconds, rmse, np.arange(5.0) < 3.0])
    stretches = np.column_stack([np.arange(5.0), np.arange(5.0) < 3.0])
    return Rung(errors, np.full(4, 4.0), np.full(4, 3.8), np.array([[0.02, 0.1], [0.04, 0.1]]), minutes, stretches)


def climbed() -> Climb:
    score = 100.0 - np.abs(np.arange(len(RATES)) - 2.0)
    rmse = 1.0 + np.abs(np.arange(len(RATES)) - 3.0)
    return Climb([RateCurve(score, rmse, 2)], {tracker: [rung(1.0), rung(2.0)] for tracker in TRACKERS})


def test_each_stage_is_held_against_the_one_before() -> None:
    figures = ladder_figures([climbed(), climbed()], "trial1")
    none = np.percentile(np.concatenate([np.arange(1.0, 11.0), 2.0 * np.arange(1.0, 11.0)] * 2), 70.0)
    assert figures["trial1_p70_none"] == pytest.approx(none)
    assert figures["trial1_p70_all_rbmcda"] == pytest.approx(0.8**3 * none)
    assert [figures[f"trial1_p90_gain_{stage}"] for stage in STAGES[1:]] == [pytest.approx(0.2)] * 3
    assert "trial1_p90_gain_none" not in figures


def test_a_rate_beside_the_best_one_is_told_with_what_it_costs() -> None:
    figures = rate_figures([climbed()], "trial1")
    assert figures["trial1_rate_chosen"] == pytest.approx(RATES[2])
    assert figures["trial1_rate_best"] == RATES[3]
    assert figures["trial1_rate_loss"] == pytest.approx(1.0)


def test_lessons_are_held_against_what_the_truth_teaches() -> None:
    figures = lesson_figures([climbed()])
    assert figures["radio_rmse_excess_db"] == pytest.approx(0.2)
    assert figures["stride_error_rbmcda"] == pytest.approx(0.03)
    assert figures["stride_way_error_rbmcda"] == pytest.approx(0.1)
    assert figures["quality_spearman_per_s"] == pytest.approx(-1.0)
    assert figures["quality_spearman_rbmcda"] == pytest.approx(-0.7)
    assert figures["good_tracks"] == pytest.approx(0.6)
    assert figures["good_tracks_p90"] == pytest.approx(2.0)
    assert figures["refused_tracks_p90"] == pytest.approx(4.0)


def recovery(ratio: list[float]) -> Recovery:
    same = np.ones(BEFORE + len(ratio))
    learning = np.concatenate([np.ones(BEFORE), np.array(ratio)])
    return Recovery(same, same, 4.0 * same, learning, [CHANGED + 90.0])


def test_recovery_counts_from_where_errors_are_back_and_stay_so() -> None:
    assert recovery_figures([recovery([2.0, 1.0, 1.8, 1.05, 1.0, 1.0])])["recovery_s"] == 3 * WINDOW
    assert recovery_figures([recovery([1.0] * 6)])["recovery_s"] == 0.0
    assert recovery_figures([recovery([2.0] * 6)])["recovery_s"] is None


def test_the_gate_is_judged_by_what_went_live_and_by_what_should_have() -> None:
    bouts = [
        Bout("learned", 0.1, True, -0.2, 0.02),
        Bout("learned", 0.0, False, -0.1, 0.04),
        Bout("stale", 0.01, True, 0.03),
        Bout("swapped", -0.1, False, 0.5),
    ]
    figures = gate_figures(bouts)
    assert figures["worst_loss"] == pytest.approx(0.03)
    assert figures["good_activated"] == pytest.approx(0.5)
    assert (figures["bad"], figures["bad_activated"]) == (2, 1)
    assert (figures["surely_good"], figures["surely_good_activated"], figures["surely_bad_activated"]) == (1, 1.0, 1)
    assert gate_figures([bouts[3]])["good_activated"] is None


def test_a_change_is_as_doubtful_as_minutes_disagree() -> None:
    before, after = np.full((10, 2), 2.0), np.full((10, 2), 1.0)
    before[0, 1] = after[3, 0] = np.nan
    assert change_of(before, after) == pytest.approx((-0.5, 0.0))
    change, doubt = change_of(np.full((10, 2), 2.0), np.repeat([1.0, 3.0], 10).reshape(10, 2))
    assert change == pytest.approx(0.0)
    assert doubt == pytest.approx(0.5 * np.sqrt(1.0 / 9.0), rel=1e-6)


def test_there_are_fifty_candidates_of_every_kind() -> None:
    areas = [len(load(name)[1].areas) for name in WORLDS]
    assert EACH * sum(areas) == 50
    firsts = [
        EACH * (2 * number + place) + more
        for number, count in enumerate(areas)
        for place in range(count)
        for more in range(EACH)
    ]
    numbers = np.bincount([first % len(KINDS) for first in firsts], minlength=len(KINDS))
    assert numbers.min() >= 4


def test_a_malicious_phone_invents_the_same_wherever_it_is_and_nobody_else_does(tmp_path: Path) -> None:
    world = World(make_site(tmp_path), seed=3, people=2, seconds=20.0)
    scans: dict[str, list[RadioScan]] = {}
    for scan in world.scans():
        scans.setdefault(scan.device, []).append(scan)
    truth = Truth(np.zeros(1), [], [], np.zeros((1, 0, 2)), np.zeros((1, 0), bool))
    arrivals = sorted(((s.t, s) for one in scans.values() for s in one), key=lambda entry: entry[0])
    record = WorldRecord(world.site, world.site.areas[0].id, arrivals, [], scans, {}, truth, np.zeros((3, 2)))
    liar = poisoned(record, "1", np.random.default_rng(1))
    assert liar.scans["0"] == scans["0"]
    told = {name: {level for s in liar.scans["1"] for n, level in zip(s.access_point, s.rssi, strict=True) if n == name}
            for s in scans["1"] for name in s.access_point}  # fmt: skip
    assert told
    assert all(len(levels) == 1 for levels in told.values())
    assert [said for _, said in liar.arrivals if isinstance(said, RadioScan) and said.device == "1"] == liar.scans["1"]


def test_a_message_told_later_is_later_in_every_time_it_names() -> None:
    batch = MotionBatch(
        t=2.0, device="a", seq=1, t_start=1.0, activity="walking", step_t=[1.5], length=[0.7], length_variance=[0.1],
        heading=[0.0], heading_variance=[0.1], turn_t=[1.2], turn=[0.5], revises_from=0.5,
    )  # fmt: skip
    later = shifted(batch, 10.0)
    assert isinstance(later, MotionBatch)
    assert (later.t, later.t_start, later.step_t, later.turn_t, later.revises_from) == (
        12.0,
        11.0,
        [11.5],
        [11.2],
        10.5,
    )


def test_everything_is_drawn(tmp_path: Path) -> None:
    bouts = [Bout(kind, 0.1, live, -0.1) for kind in KINDS for live in (True, False)]
    draw_learning({"construction-1": [climbed()]}, tmp_path / "learning.png")
    draw_gate(bouts, tmp_path / "gate.png")
    draw_recovery({"construction-1": [recovery([2.0, 1.0])]}, tmp_path / "recovery.png")
    assert all((tmp_path / f"{name}.png").stat().st_size > 10_000 for name in ("learning", "gate", "recovery"))
