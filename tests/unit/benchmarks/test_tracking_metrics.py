"""The scores of tracks with a known answer."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from msgspec.structs import replace as changed
from numpy.typing import NDArray

from benchmarks.tracking_metrics import score_record, score_tracks
from benchmarks.world_record import Truth
from shared.messages import TrackFrame

FRAMES = 20


@dataclass(frozen=True)
class TwoPeople:
    """Two people stand six metres apart; the second is out of view in the first half."""

    frame: NDArray[np.int64]
    person: NDArray[np.int64]
    position: NDArray[np.float64]
    in_view: NDArray[np.bool_]


TRUTH = TwoPeople(
    frame=np.repeat(np.arange(FRAMES), 2),
    person=np.tile([7, 8], FRAMES),
    position=np.tile([[0.0, 0.0], [6.0, 0.0]], (FRAMES, 1)),
    in_view=np.array([[True, number >= FRAMES // 2] for number in range(FRAMES)]).ravel(),
)


def tracks(number: int, ids: list[int], x: list[float]) -> TrackFrame:
    count = len(ids)
    return TrackFrame(
        t=number / 7, area="a", chunk=number, tracker="t", track=ids, floor=["g"] * count, x=x, y=[0.3] * count,
        covariance=[(1.0, 0.0, 1.0)] * count, vx=[0.0] * count, vy=[0.0] * count, state=["confirmed"] * count,
        device=[None] * count, probability=[1.0] * count, runner_up=[None] * count,
        runner_up_probability=[0.0] * count, former=[[]] * count, sources=[[]] * count, quality=[1.0] * count,
    )  # fmt: skip


def test_perfect_tracks_score_one_and_people_out_of_view_do_not_count() -> None:
    found = {n: tracks(n, [1, 2] if n >= 10 else [1], [0.0, 6.0] if n >= 10 else [0.0]) for n in range(FRAMES)}
    score = score_tracks(TRUTH, found, 0, FRAMES - 1)
    assert (score.mota, score.idf1, score.switches, score.precision, score.recall) == (1.0, 1.0, 0, 1.0, 1.0)
    assert score.rmse == pytest.approx(0.3)


def test_a_swap_costs_two_switches_and_identity() -> None:
    found = {n: tracks(n, [1, 2] if n < 15 else [2, 1], [0.0, 6.0]) for n in range(10, FRAMES)}
    score = score_tracks(TRUTH, found, 10, FRAMES - 1)
    assert score.switches == 2
    assert score.idf1 == pytest.approx(0.5)
    assert score.mota == pytest.approx(1 - 2 / 20)


def test_a_missing_frame_is_a_frame_without_tracks() -> None:
    score = score_tracks(TRUTH, {0: tracks(0, [1], [0.0])}, 0, 4)
    assert score.recall == pytest.approx(0.2)
    assert score.frames == 5


def test_farther_than_the_gate_is_both_a_miss_and_a_false_track() -> None:
    score = score_tracks(TRUTH, {n: tracks(n, [1], [1.5]) for n in range(10)}, 0, 9)
    assert score.mota == pytest.approx(-1.0)
    assert math.isnan(score.rmse)


def test_hota_of_perfect_places_depends_on_association_alone() -> None:
    found = {n: tracks(n, [1, 2] if n < 15 else [2, 1], [0.0, 6.0]) for n in range(10, FRAMES)}
    exact = {n: changed(frame, y=[0.0, 0.0]) for n, frame in found.items()}
    score = score_tracks(TRUTH, exact, 10, FRAMES - 1)
    assert score.detection_accuracy == pytest.approx(1.0)
    # Each pairing holds for half of both: TPA 5, FNA 5, FPA 5.
    assert score.association_accuracy == pytest.approx(1 / 3)
    assert score.hota == pytest.approx(math.sqrt(1 / 3))


def test_hota_counts_a_place_half_a_gate_off_at_similarities_up_to_three_quarters() -> None:
    found = {n: changed(tracks(n, [1], [0.5]), y=[0.0]) for n in range(10)}
    score = score_tracks(TRUTH, found, 0, 9)
    # Similarity 1 - 0.5 / 2 = 0.75: 15 of the 19 thresholds 0.05 ... 0.95.
    assert score.hota == pytest.approx(15 / 19)


def test_no_tracks_at_all_have_no_hota_and_nobody_about_has_no_score() -> None:
    assert score_tracks(TRUTH, {}, 0, 9).hota == 0.0
    assert math.isnan(score_tracks(TRUTH, {}, 30, 39).hota)


def test_a_worlds_truth_is_scored_with_the_newest_tracks_that_are_not_stale() -> None:
    t = 1.7e9 + np.arange(20) * 0.5
    position = np.broadcast_to(np.array([[0.0, 0.3], [6.0, 0.3]]), (20, 2, 2)).copy()
    position[10:, 1] = np.nan
    truth = Truth(t, ["a", "b"], [None, None], position, np.ones((20, 2), np.bool_))
    frames = [changed(tracks(n, [1], [0.0]), t=float(t[n]) + 1e-7) for n in range(0, 15, 3)]
    score = score_record(truth, frames)
    assert score.precision == 1.0
    assert score.recall == pytest.approx(17 / 30)  # the last, of frame 12, is stale 2.25 s later; b is missed
    assert score_record(truth, frames, every=2).frames == 10
    assert score_record(truth, []).recall == 0.0
