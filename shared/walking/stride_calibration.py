"""What is somebody's stride line, from two trial walks of known length at two cadences?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.walking.stride import LENGTHS, StrideLine

__all__ = ["StrideCalibrationError", "TrialWalk", "two_walks"]

Array = NDArray[np.float64]

LEAST_STEPS = 8
LEAST_DIFFERENCE = 0.15
"""Steps per second between the two walks; closer ones say nothing of the slope."""
SLOPES = (0.0, 1.2)
"""m per step/s; a person whose quicker steps are shorter, or much longer, was not measured right."""
COUNT_SIGMA = 0.7
"""Steps by which the length of a walk is no whole number of steps, or one step was missed."""
DAY_SIGMA = 0.03
"""Of a person's steps on another day, in other shoes, as a share."""


class StrideCalibrationError(ValueError):
    """Two trial walks do not give a line: the text says which walk, what was found and what is allowed."""


@dataclass(frozen=True, slots=True)
class TrialWalk:
    """A walk at roughly constant cadence.

    Attributes:
        distance: m, along the walls where it went around corners.
        step_t: (n,) s, when each step ended, ascending.
    """

    distance: float
    step_t: Array


def two_walks(first: TrialWalk, second: TrialWalk) -> StrideLine:
    """Return the line through mean cadence and mean length of two walks [self-calibrating-rss-thesis §3.6, Eq. 3.26].

    Raises:
        StrideCalibrationError: a walk is too short, its steps have no human length, or the two are too alike.
    """
    (f1, l1), (f2, l2) = _means(first, "first"), _means(second, "second")
    if abs(f1 - f2) < LEAST_DIFFERENCE:
        raise StrideCalibrationError(
            f"second walk: {f2:.2f} steps per second, the first had {f1:.2f}; allowed: {LEAST_DIFFERENCE} apart or more"
        )
    slope = (l1 - l2) / (f1 - f2)
    if not SLOPES[0] <= slope <= SLOPES[1]:
        raise StrideCalibrationError(
            f"second walk: steps of {l2:.2f} m at {f2:.2f} per second, the first had {l1:.2f} m at {f1:.2f}, that is "
            f"{slope:.2f} m per step/s; allowed: {SLOPES[0]:g} to {SLOPES[1]:g}"
        )
    counts = np.array([len(first.step_t), len(second.step_t)])
    variance = float(np.mean((COUNT_SIGMA / counts) ** 2)) + DAY_SIGMA**2
    return StrideLine(np.array(slope), np.array(l1 - slope * f1), np.array(variance))


def _means(walk: TrialWalk, name: str) -> tuple[float, float]:
    """Return mean cadence, steps/s, and mean length, m."""
    steps = len(walk.step_t)
    if steps < LEAST_STEPS:
        raise StrideCalibrationError(f"{name} walk: {steps} steps; allowed: {LEAST_STEPS} or more")
    seconds = float(walk.step_t[-1] - walk.step_t[0])
    if not np.isfinite(seconds) or seconds <= 0.0 or np.any(np.diff(walk.step_t) <= 0.0):
        raise StrideCalibrationError(f"{name} walk: times of steps are not ascending")
    length = walk.distance / steps
    if not LENGTHS[0] <= length <= LENGTHS[1]:
        raise StrideCalibrationError(
            f"{name} walk: {walk.distance:g} m in {steps} steps, {length:.2f} m each; "
            f"allowed: {LENGTHS[0]:g} to {LENGTHS[1]:g} m"
        )
    return (steps - 1) / seconds, length
