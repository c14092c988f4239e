"""What a phone tells of its walk, in stretches of about a second from step to step.

A step's length was walked since the step before it: cut at round seconds instead, a steady walk would seem to stop and
start. A walk is told only after some regular steps, then from its first one on; what a phone calls neither standing nor
walking says nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.messages import MotionBatch

__all__ = ["BIAS", "SCALE", "Walk", "stretches"]

Array = NDArray[np.float64]

BIAS = math.radians(15.0)
"""Standard deviation of what all headings of a walk are off by, where the sender does not say."""
SCALE = 0.12
"""Standard deviation of a walk's stride scale where the sender does not say, and the least that is believed."""
UNKNOWN_HEADING = 2.0
"""rad²; a heading with more variance is none."""
LASTING = 0.5
"""Share of a heading's own variance that lasts for a second or more instead of averaging out over its steps."""
FIRST_STEP = 0.6
"""Seconds that a step takes of which no other came before, and the longest that one may take."""
LONGEST_STEP = 1.5
EARLIEST = 30.0
"""Seconds before a batch's own beginning before which no step of it can be; a walk is told some steps late."""
STRETCH = 0.8
"""Seconds after which a stretch ends with the next step."""


@dataclass(frozen=True, slots=True)
class Walk:
    """One stretch of a phone's dead reckoning, about a second.

    Attributes:
        t_start, t: its time.
        length: metres walked.
        heading: mean direction, radians; NaN where there is none.
        heading_variance: rad², without what all of the walk share.
        other: the other direction it may be, NaN for none; ``other_probability`` of that.
        bias_variance: rad², of what all headings of the walk share; ``scale_variance``: of its stride scale.
        number: of the walk.
    """

    t_start: float
    t: float
    length: float
    heading: float
    heading_variance: float
    other: float = math.nan
    other_probability: float = 0.0
    bias_variance: float = BIAS**2
    scale_variance: float = SCALE**2
    number: int = 0


def stretches(batch: MotionBatch, last_step: float) -> list[Walk]:
    """Return the stretches that a batch tells; none where it tells nothing of use.

    Args:
        batch: of one phone.
        last_step: when its last step before ended, s; minus infinity for none.
    """
    if batch.activity == "still" and not batch.step_t:
        duration = batch.t - batch.t_start
        return [Walk(batch.t_start, batch.t, 0.0, math.nan, 0.0)] if 0.3 <= duration <= 10.0 else []
    when, metres = np.asarray(batch.step_t, float), np.asarray(batch.length, float)
    usable = np.isfinite(when) & np.isfinite(metres) & (metres >= 0.0) & (metres < 3.0)
    usable &= (when > last_step) & (when > batch.t_start - EARLIEST) & (when <= batch.t + 1.0)
    chosen = np.flatnonzero(usable)
    chosen = chosen[np.argsort(when[chosen], kind="stable")]
    walks: list[Walk] = []
    mine: list[int] = []
    begin = last_step
    for step in chosen.tolist():
        if not when[step] - begin <= (LONGEST_STEP if not mine else STRETCH + LONGEST_STEP):
            if mine:
                walks.append(_walk(batch, begin, mine))
            begin, mine = float(when[step]) - FIRST_STEP, []
        mine.append(step)
        if when[step] - begin >= STRETCH:
            walks.append(_walk(batch, begin, mine))
            begin, mine = float(when[step]), []
    if mine:
        walks.append(_walk(batch, begin, mine))
    return walks


def _walk(batch: MotionBatch, begin: float, steps: list[int]) -> Walk:
    metres = np.array([batch.length[step] for step in steps])
    direction = np.array([batch.heading[step] for step in steps])
    spread = np.array([batch.heading_variance[step] for step in steps])
    known = np.isfinite(direction) & (spread < UNKNOWN_HEADING) & (spread >= 0.0)
    towards, uncertainty, elsewhere, chance = math.nan, math.inf, math.nan, 0.0
    shared = batch.heading_bias_variance
    bias = shared if 0.0 < shared < UNKNOWN_HEADING else BIAS**2
    if known.any():
        towards = _mean_direction(direction[known], metres[known])
        own = max(float(spread[known].mean()) - max(shared, 0.0), 0.0)
        uncertainty = own * (1.0 - LASTING) / known.sum()
        bias += LASTING * own
        if batch.other_heading:
            other = np.array([batch.other_heading[step] for step in steps])
            doubt = np.array([batch.other_probability[step] for step in steps])
            told = known & np.isfinite(other) & (doubt > 0.0)
            if told.any():
                elsewhere, chance = _mean_direction(other[told], metres[told]), float(doubt[told].mean())
    scale = max(batch.length_scale_variance, SCALE**2) if batch.length_scale_variance < 1.0 else SCALE**2
    end = float(batch.step_t[steps[-1]])
    total = float(metres.sum())
    return Walk(begin, end, total, towards, uncertainty, elsewhere, chance, bias, scale, batch.walk)


def _mean_direction(direction: Array, weight: Array) -> float:
    return math.atan2(float((weight * np.sin(direction)).sum()), float((weight * np.cos(direction)).sum()))
