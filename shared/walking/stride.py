"""How long is a step? From cadence and bounce for anybody, from a line of their own for people who are known.

A length is wrong in two ways that a filter must tell apart: each step by itself, and all steps of a walk by one
factor, since people and phones differ. Every prediction says how much of either.

The universal model, ``a f + b + c bounce^¼``, was fitted to the traces of ``indoor-location`` (``atrium bench dead-
reckoning``). That a quicker step is a shorter one *at the same bounce* is the inverted pendulum's law: bounce grows
with the square of length times cadence. The traces' surveyors are not everybody, and people of ``step-counter`` who
walk at the same cadence differ in bounce by a factor of two: what the traces say of a and c is believed by three
quarters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "BELIEF",
    "BOUNCE_WINDOW",
    "CADENCES",
    "USUAL_CADENCE",
    "StepLengths",
    "StrideLine",
    "by_height",
    "step_lengths",
]

Array = NDArray[np.float64]

USUAL_CADENCE = 1.85
"""Steps per second, ± 0.12 between walks."""
BOUNCE_WINDOW = 1.0
"""s, half of it on either side of a step."""
CADENCES = (1.5, 2.3)
"""Steps per second between which the universal model knows anything; beyond, the nearer one counts."""
LENGTHS = (0.3, 1.3)
"""m."""
HEIGHT = 1.72
"""m, of people of whom nothing is known."""

USUAL_LENGTH, USUAL_BOUNCE = 0.693, 8.0
"""m, and m/s²."""
BELIEF = 0.75
"""Of what the traces say of the two slopes below."""
PER_CADENCE = -0.265
"""m per step/s at the same bounce."""
PER_BOUNCE = 0.357
"""m per (m/s²)^¼."""

STEP_SIGMA = 0.30
"""Of a step's length against the others of its walk, as a share: by a twelfth of its length a leg of a dozen steps is
off by itself, missed steps among them, and who adds steps up as if each erred by itself is right about the sum."""
SCALE_SIGMA = 0.08
"""Of a walk's lengths against the universal model with bounce, as a share; ``UNSEEN_SIGMA`` without. It is what the
traces of two surveyors say. Strangers may differ more: at one cadence the people of ``step-counter`` bounce by 2.7 to
9.9 m/s², and what that means for their lengths nobody has measured."""
UNSEEN_SIGMA = 0.15


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
        bounce: (m,) m/s², peak to peak of the acceleration's norm at the rhythm of steps; NaN where the phone is not
            held in the hand, since in a pocket it says more of the leg than of the length.
        line: what is known of the steps' people.
    """
    known_cadence = np.where(np.isfinite(cadence), cadence, USUAL_CADENCE)
    held = np.isfinite(bounce)
    bounced = np.maximum(np.where(held, bounce, 0.0), 0.0) ** 0.25 - USUAL_BOUNCE**0.25
    quicker = np.clip(known_cadence, *CADENCES) - USUAL_CADENCE
    length = np.where(held, USUAL_LENGTH + PER_CADENCE * quicker + PER_BOUNCE * bounced, by_height(known_cadence))
    scale = np.where(held, SCALE_SIGMA**2, UNSEEN_SIGMA**2)
    if line is not None:
        known = (np.asarray(line.slope) != 0.0) | (np.asarray(line.offset) != 0.0)
        length = np.where(known, line.slope * known_cadence + line.offset, length)
        scale = np.where(known, line.scale_variance, scale)
    length = np.clip(length, *LENGTHS)
    return StepLengths(length, length**2 * (STEP_SIGMA**2 + scale), scale)


def by_height(cadence: Array, height: float = HEIGHT) -> Array:
    """Return ``height (a cadence + b)`` (m,) m [ravel-thesis §6.2, Eq. 4.3/5.2], for phones whose bounce says nothing.

    The thesis leaves a and b open; these give 0.70 m at the usual cadence and the slope of the example user of
    [self-calibrating-rss-thesis §3.6], 0.35 m per step/s.
    """
    return height * (0.203 * cadence + 0.031)
