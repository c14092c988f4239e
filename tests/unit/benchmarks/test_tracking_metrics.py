"""The scores of tracks with a known answer."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.tracking_metrics import score_tracks
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
