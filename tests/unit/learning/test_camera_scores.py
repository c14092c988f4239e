"""Scores of cameras over time: of the tracks they feed, also while they miss them."""

import pytest

from services.learning.cameras.camera_scores import KEPT, PERIOD, CameraScores
from shared.messages import TrackFrame


def frame(t: float, sources: dict[int, list[str]]) -> TrackFrame:
    n = len(sources)
    return TrackFrame(
        t=t,
        area="hall",
        chunk=round(t),
        tracker="evidence",
        track=list(sources),
        floor=["ground"] * n,
        x=[0.0] * n,
        y=[0.0] * n,
        covariance=[(0.1, 0.0, 0.1)] * n,
        vx=[0.0] * n,
        vy=[0.0] * n,
        state=["confirmed"] * n,
        device=[None] * n,
        probability=[1.0] * n,
        runner_up=[None] * n,
        runner_up_probability=[0.0] * n,
        former=[[] for _ in range(n)],
        sources=list(sources.values()),
        quality=[1.0] * n,
    )


def test_each_camera_is_scored_by_the_tracks_it_feeds_also_while_it_misses_them() -> None:
    scores = CameraScores(["east", "west"])
    for second in range(round(PERIOD) + 1):
        seen = second % 2 == 0
        scores.take(
            frame(second, {1: ["east", "phone"] if seen else [], 2: ["west"]}), {1: 3.0 if seen else -1.0, 2: 2.0}
        )
    assert scores.of("east")[0] == [PERIOD]
    assert scores.of("east")[1] == [pytest.approx(1.0, abs=0.02)]
    assert scores.of("west")[1] == [pytest.approx(2.0)]


def test_silence_a_clock_set_back_and_hardly_any_tracks_give_no_score() -> None:
    scores = CameraScores(["east"])
    for t in [*range(200), *range(100, 300), *range(400, 650)]:
        scores.take(frame(t, {1: ["east"]}), {1: 1.0})
    assert scores.of("east") == ([], [])
    for t in range(700, 700 + round(PERIOD) + 1):
        scores.take(frame(t, {1: ["east"]} if t < 740 else {}), {1: 1.0})
    assert scores.of("east") == ([], [])


def test_only_a_day_is_kept() -> None:
    scores = CameraScores(["east"])
    scores._cameras["east"].told.extend((float(n), 1.0) for n in range(2 * KEPT))
    assert len(scores.of("east")[0]) == KEPT
