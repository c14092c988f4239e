"""A camera's clock read off its people's steps: right within a tenth of a second, silent where nobody says anything."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from walked_stretch import walked

from services.learning.walking.step_clock import StepClock
from shared.messages import DetectionFrame, MotionBatch

T0 = 1000.0


def frame(t: float, place: np.ndarray, others: list[tuple[float, float]]) -> DetectionFrame:
    spots = [(float(place[0]), float(place[1])), *others]
    count = len(spots)
    return DetectionFrame(
        t=t,
        camera="east",
        floor="ground",
        seq=0,
        x=[spot[0] for spot in spots],
        y=[spot[1] for spot in spots],
        covariance=[(0.04, 0.0, 0.04)] * count,
        confidence=[0.9] * count,
        box=[(0.0, 0.0, 1.0, 1.0)] * count,
    )


def heard(offset: float, seed: int, stops: bool = True, minutes: int = 4) -> StepClock:
    """Somebody walks and stands for some minutes; the camera's clock is ahead by ``offset`` seconds."""
    rng = np.random.default_rng(seed)
    clock = StepClock()
    for minute in range(minutes):
        begin = T0 + 60.0 * minute
        t = np.arange(begin, begin + 40.0, 0.02)
        walks = np.ones(len(t), bool)
        if stops:
            edges = begin + np.cumsum(rng.uniform(3.0, 7.0, 12))
            walks = np.searchsorted(edges, t) % 2 == 0
        way = np.cumsum(np.where(walks, 1.2, 0.0)) * 0.02
        direction = rng.uniform(-np.pi, np.pi)
        place = way[:, None] * [np.cos(direction), np.sin(direction)]
        step_t = np.interp(np.arange(0.65, way[-1], 0.65), way, t)
        clock.take_motion(
            MotionBatch(
                t=begin + 45.0, t_start=begin, device="phone", seq=minute, activity="walking", step_t=step_t.tolist(),
                length=[0.65] * len(step_t), length_variance=[0.04] * len(step_t), heading=[0.0] * len(step_t),
                heading_variance=[1.0] * len(step_t),
            )
        )  # fmt: skip
        for k in range(0, len(t), 10):
            spot = place[k] + rng.normal(0.0, 0.12, 2)
            clock.take_frame(frame(t[k] + offset, spot, [(float(place[k, 0]) + 5.0, 0.0)]))
        stretch = walked(rng, begin, seconds=40.0)
        rows = np.clip(np.searchsorted(t + offset, stretch.t), 0, len(t) - 1)
        stretch.place[:] = place[rows]
        stretch.t[:] = t[rows] + offset + 1e-6 * np.arange(len(rows))
        clock.learn(stretch)
    return clock


@settings(max_examples=6, deadline=None)
@given(st.sampled_from([-0.6, -0.3, 0.0, 0.3, 0.6]), st.integers(0, 1000))
def test_an_offset_is_found_as_well_as_is_said(offset: float, seed: int) -> None:
    reading = heard(offset, seed, minutes=6).reading("east")
    assert reading.offset is not None
    assert reading.error is not None
    assert abs(reading.offset - offset) < 3.0 * reading.error
    assert 0.05 < reading.error < 0.2


@pytest.mark.parametrize("offset", [-0.3, 0.0, 0.3])
def test_after_ten_minutes_an_offset_is_known_within_a_tenth_of_a_second_and_told(offset: float) -> None:
    reading = heard(offset, 1, minutes=10).reading("east")
    assert reading.offset == pytest.approx(offset, abs=0.1)
    assert bool(reading.words) == (offset != 0.0)


def test_the_words_say_which_way_and_what_to_do() -> None:
    assert "earlier" in heard(-0.6, 1, minutes=6).reading("east").words
    words = heard(0.6, 1, minutes=6).reading("east").words
    assert "0.6 s later" in words
    assert "site file" in words


def test_a_steady_walk_says_nothing_and_neither_does_an_unknown_camera() -> None:
    assert heard(0.3, 1, stops=False, minutes=6).reading("east").offset is None
    assert heard(0.3, 1).reading("west").offset is None


def test_memory_is_bounded_and_a_device_is_forgotten() -> None:
    clock = heard(0.0, 1, minutes=6)
    assert len(clock._frames["east"]) <= 90.0 / 0.19 + 1
    assert min(t for t, _ in clock._steps["phone"]) > T0 + 200.0
    clock.forget("phone")
    assert not clock._steps


def test_whoever_left_is_not_remembered() -> None:
    clock = StepClock()
    for visitor in range(200):
        begin = T0 + 60.0 * visitor
        clock.take_motion(
            MotionBatch(
                t=begin + 1.0, t_start=begin, device=f"phone-{visitor}", seq=0, activity="walking", step_t=[begin],
                length=[0.7], length_variance=[0.04], heading=[0.0], heading_variance=[1.0],
            )
        )  # fmt: skip
    assert sorted(clock._steps) == ["phone-198", "phone-199"]
