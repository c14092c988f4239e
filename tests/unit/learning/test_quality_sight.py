"""Cameras' part of a track's quality: honest predictions, looks of one second, p_d and clutter from the data."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from services.learning.tracks.sight import SightScore
from shared.messages import DetectionFrame, TrackFrame
from shared.site import ViewMap

WEST = ViewMap(np.zeros(2), 1.0, np.where(np.arange(20) < 10, 5.0, -5.0) * np.ones((10, 1)))


def _detections(t: float, places: NDArray[np.float64], camera: str = "west") -> DetectionFrame:
    count = len(places)
    return DetectionFrame(
        t=t, camera=camera, floor="ground", seq=0, x=places[:, 0].tolist(), y=places[:, 1].tolist(),
        covariance=[(0.04, 0.0, 0.04)] * count, confidence=[0.9] * count, box=[(0.0, 0.0, 1.0, 1.0)] * count,
    )  # fmt: skip


def _tracks(t: float, places: NDArray[np.float64], seen: list[bool], speed: float = 1.0) -> TrackFrame:
    count = len(places)
    return TrackFrame(
        t=t, area="hall", chunk=int(t * 100), tracker="test", track=list(range(1, count + 1)), floor=["g"] * count,
        x=places[:, 0].tolist(), y=places[:, 1].tolist(), covariance=[(0.01, 0.0, 0.01)] * count,
        vx=[speed] * count, vy=[0.0] * count, state=["confirmed" if one else "coasting" for one in seen],
        device=[None] * count, probability=[0.5] * count, runner_up=[None] * count,
        runner_up_probability=[0.0] * count, former=[[]] * count,
        sources=[["west"] if one else [] for one in seen], quality=[1.0] * count,
    )  # fmt: skip


def _walk(score: SightScore, rate: int, seconds: float, noise: float = 0.2, lost: float = 0.1, seed: int = 0) -> float:
    """Two people walk, one in view, one not; return the nats of the first per second."""
    rng = np.random.default_rng(seed)
    total = 0.0
    for k in range(1, round(seconds * rate)):
        t = k / rate
        places = np.array([[1.0 + t % 8.0, 3.0], [15.0, 5.0]])
        if t % 8.0 < 1.5 / rate:
            continue
        seen = bool(rng.random() >= lost)
        heard = places[:1] + rng.normal(0.0, noise, (1, 2)) if seen else np.zeros((0, 2))
        if rng.random() < 0.3:
            heard = np.concatenate([heard, rng.uniform((0.0, 6.0), (9.0, 9.0), (1, 2))])
        score.take_detections(_detections(t, heard))
        gains = score.score(_tracks(t, places, [seen, False]))
        total += gains.get(1, 0.0)
        assert gains.get(2, 0.0) == 0.0  # outside every view: nobody looked
    return total / seconds


def test_detection_and_clutter_are_learned_from_the_data() -> None:
    score = SightScore({"west": WEST})
    _walk(score, 10, 300.0, lost=0.25)
    assert score.detected()["west"] == pytest.approx(0.75, abs=0.05)
    assert score.clutter()["west"] == pytest.approx(0.3 / 100.0, rel=0.2)


def test_the_score_does_not_depend_on_the_frame_rate() -> None:
    slow, fast = (_walk(SightScore({"west": WEST}), rate, 90.0) for rate in (6, 24))
    assert slow == pytest.approx(fast, rel=0.25)  # four times as many looks; a longer prediction is a vaguer one
    assert fast > 1.0


def test_a_look_at_a_place_without_a_detection_costs_log_one_minus_p_d() -> None:
    score = SightScore({"west": WEST})
    _walk(score, 10, 30.0)
    for t in (100.0, 100.1, 100.2):
        score.take_detections(_detections(t, np.zeros((0, 2))))
        before = score.detected()["west"]
        gains = score.score(_tracks(t, np.array([[5.0, 3.0]]), [False]))
    assert gains[1] == pytest.approx(0.1 * math.log(1.0 - before), rel=0.05)


def test_what_comes_where_it_was_predicted_speaks_more_than_what_does_not() -> None:
    def gain(beside: float) -> float:
        score = SightScore({"west": WEST})
        _walk(score, 10, 30.0)
        score.take_detections(_detections(100.0, np.array([[5.0, 3.0]])))
        score.score(_tracks(100.0, np.array([[5.0, 3.0]]), [True]))
        score.take_detections(_detections(100.1, np.array([[5.1, 3.0 + beside]])))
        # The track follows its detection: only the prediction from before tells that it jumped.
        return score.score(_tracks(100.1, np.array([[5.1, 3.0 + beside]]), [True]))[1]

    near, far, farther = gain(0.0), gain(0.5), gain(2.0)
    assert near > far > farther


def test_other_cameras_clocks_set_back_and_empty_frames_do_no_harm() -> None:
    score = SightScore({"west": WEST})
    _walk(score, 10, 20.0)
    score.take_detections(_detections(30.0, np.array([[5.0, 3.0]]), camera="elsewhere"))
    score.take_detections(_detections(3.0, np.array([[5.0, 3.0]])))
    gains = score.score(_tracks(3.0, np.array([[5.0, 3.0]]), [True]))
    assert np.isfinite(list(gains.values())).all()
    assert score.score(_tracks(3.1, np.zeros((0, 2)), [])) == {}
    for k in range(500):
        score.take_detections(_detections(1e6 + k, np.zeros((0, 2))))
    assert len(score._cameras["west"].waiting) <= 32
