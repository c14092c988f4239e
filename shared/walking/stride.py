"""How long is a step? From its cadence and its bounce for anybody, from a line of their own for people who are known.

A length is wrong in two ways that a filter must tell apart: each step by itself, and all steps of a walk by one factor,
since people and phones differ. Every prediction says how much of either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["BOUNCE_WINDOW", "StepLengths", "StrideLine", "step_lengths"]

Array = NDArray[np.float64]

BOUNCE_WINDOW = 0.6
"""s, half of it on either side of a step: within it the acceleration's norm rises and falls once at least."""
CADENCES = (1.0, 3.0)
"""Steps per second between which people walk; others are taken for the nearer of the two."""
LENGTHS = (0.3, 1.3)
"""m."""
STEP_SIGMA = 0.08
"""Of a step's length against the mean of its walk, as a share."""
SCALE_SIGMA = 0.07
"""Of a walk's lengths against the universal model, as a share."""


@dataclass(frozen=True, slots=True)
class StrideLine:
    """Personal models, ``length = slope x cadence + offset``: m of them, or one for all steps.

    All zeros stand for somebody of whom nothing is known: the universal model holds.

    Attributes:
        slope: (m,) or (), m per step/s.
        offset: (m,) or (), m.
        scale_variance: (m,) or (), of the factor by which the line may be wrong for this person.
    """

    slope: Array
    offset: Array
    scale_variance: Array


@dataclass(frozen=True, slots=True)
class StepLengths:
    """Lengths of m steps.

    Attributes:
        length: (m,) m.
        variance: (m,) m², of a step taken by itself: ``length² x scale_variance`` is part of it.
        scale_variance: (m,) of the factor by which all lengths of the walk are wrong.
    """

    length: Array
    variance: Array
    scale_variance: Array


def step_lengths(cadence: Array, bounce: Array, line: StrideLine | None = None) -> StepLengths:
    """Return the lengths of m steps.

    Args:
        cadence: (m,) steps per second, 1 / time since the step before; NaN where there is none.
        bounce: (m,) m/s², range of the acceleration's norm within ``BOUNCE_WINDOW``; NaN where the phone is not held
            in the hand, since in a pocket it says more of the leg than of the length.
        line: what is known of the steps' people.
    """
    del bounce
    f = np.clip(np.where(np.isfinite(cadence), cadence, 1.86), *CADENCES)
    length = np.full(f.shape, 0.70)
    scale = np.full(f.shape, SCALE_SIGMA**2)
    if line is not None:
        known = (np.asarray(line.slope) != 0.0) | (np.asarray(line.offset) != 0.0)
        length = np.where(known, line.slope * f + line.offset, length)
        scale = np.where(known, line.scale_variance, scale)
    length = np.clip(length, *LENGTHS)
    return StepLengths(length, length**2 * (STEP_SIGMA**2 + scale), scale)
