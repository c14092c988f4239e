"""Motion batches as stretches from step to step."""

import math
from typing import Literal

import pytest

from services.fusion.walks.stretches import stretches
from shared.messages import MotionBatch


def batch(
    t_start: float,
    t: float,
    steps: list[float],
    activity: Literal["still", "walking", "other"] = "walking",
    variance: float = 0.03,
    heading: float = 0.1,
) -> MotionBatch:
    count = len(steps)
    return MotionBatch(
        t=t, t_start=t_start, device="a", seq=0, activity=activity, step_t=steps, length=[0.7] * count,
        length_variance=[0.01] * count, heading=[heading] * count, heading_variance=[variance] * count,
    )  # fmt: skip


def test_a_steady_walk_has_one_speed_however_its_steps_fall_into_seconds() -> None:
    steps = [0.7 * number for number in range(1, 40)]
    last, speeds = -math.inf, []
    for second in range(28):
        mine = [step for step in steps if second < step <= second + 1]
        for walk in stretches(batch(second, second + 1.0, mine), last):
            speeds.append(walk.length / (walk.t - walk.t_start))
            last = walk.t
    assert len(speeds) > 15
    assert speeds[1:] == pytest.approx([1.0] * (len(speeds) - 1))


def test_a_walk_told_late_counts_from_its_first_step() -> None:
    """The batch reaches back over two that told nothing; nothing of it is lost."""
    walks = stretches(batch(8.0, 12.0, [8.6, 9.3, 10.0, 10.7, 11.4]), -math.inf)
    assert walks[0].t_start == pytest.approx(8.0)
    assert sum(walk.length for walk in walks) == pytest.approx(3.5)


def test_standing_is_standing_and_neither_is_nothing() -> None:
    (still,) = stretches(batch(10.0, 11.0, [], "still"), 9.5)
    assert still.length == 0.0
    assert math.isnan(still.heading)
    assert stretches(batch(10.0, 11.0, [], "other"), 9.5) == []
    assert stretches(batch(10.0, 10.1, [], "still"), 9.5) == []
    assert stretches(batch(10.0, 99.0, [], "still"), 9.5) == []


def test_steps_told_before_and_unknown_headings_do_not_count() -> None:
    (walk,) = stretches(batch(10.0, 11.0, [10.0, 10.9], variance=9.9), 10.0)
    assert walk.length == pytest.approx(0.7)
    assert math.isnan(walk.heading)


def test_after_a_pause_a_stretch_begins_a_step_before_its_first_step() -> None:
    first, second = stretches(batch(10.0, 20.0, [10.6, 11.4, 19.0]), 10.0)
    assert (first.t_start, first.t) == pytest.approx((10.0, 11.4))
    assert (second.t_start, second.t) == pytest.approx((18.4, 19.0))


@pytest.mark.parametrize("odd", [-1e30, -1e16, -100.0])
def test_a_step_from_another_age_is_no_step(odd: float) -> None:
    """Its time may be so large that a stretch from before it would last no time at all."""
    (walk,) = stretches(batch(0.0, 1.0, [odd, 0.4, 0.9]), -math.inf)
    assert (walk.t, walk.length) == (0.9, pytest.approx(1.4))
