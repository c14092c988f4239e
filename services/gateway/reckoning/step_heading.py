"""Which way did each step lead? The protocol of the methods, one per way of carrying a phone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from services.gateway.reckoning.hops import Array, State
from services.gateway.reckoning.recent import Recent
from services.gateway.steps.detector import Steps

__all__ = ["UNKNOWN_VARIANCE", "StepHeading", "StepHeadings"]

UNKNOWN_VARIANCE = np.pi**2 / 3
"""rad²: of a heading about which nothing is known (uniform on the circle)."""


@dataclass(frozen=True, slots=True)
class StepHeadings:
    """Headings of m steps, radians **clockwise from magnetic north** as a compass counts them.

    Attributes:
        heading: (m,).
        variance: (m,) rad², of a step taken by itself: the shared bias is part of it.
        bias_variance: (m,) rad², of the error that all steps of the walk have in common.
        other: (m,) the other heading where a sign is uncertain, else equal to ``heading``.
        other_probability: (m,) of ``other`` being right, 0 where nothing is uncertain.
    """

    heading: Array
    variance: Array
    bias_variance: Array
    other: Array
    other_probability: Array


class StepHeading(Protocol):
    """Tells the headings of steps of p phones that are all carried the same way."""

    @property
    def STATE(self) -> np.dtype[np.void]:  # noqa: N802
        """Of one phone; all zeros: nothing known yet."""

    def advance(self, state: State, recent: Recent, steps: Steps) -> StepHeadings:
        """Return the headings of ``steps`` and change ``state`` (p,) in place.

        Args:
            state: (p,) of ``STATE``.
            recent: what the p phones measured lately.
            steps: those of the newest hop.
        """
