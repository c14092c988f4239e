"""What is a step detector? The protocol that all of them keep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from services.gateway.reckoning.hops import Array, Hops, State

__all__ = ["LONGEST_DELAY", "StepDetector", "Steps"]

LONGEST_DELAY = 8.0
"""Seconds that a step may lie before the end of the hop in which it is told."""


@dataclass(frozen=True, slots=True)
class Steps:
    """Steps found in one hop of each of p phones.

    Attributes:
        phone: (m,) row of the phone, ascending.
        t: (m,) when the foot struck, phone clock, s; ascending for each phone, and never before a step told earlier.
            They may lie up to ``LONGEST_DELAY`` back: walking is recognised after it has begun.
        walking: (p,) whether the person walks at the end of the hop.
        period: (p,) s from step to step while walking, else 0.
    """

    phone: NDArray[np.int64]
    t: Array
    walking: NDArray[np.bool_]
    period: Array


class StepDetector(Protocol):
    """Finds steps in the hops of many phones; one footfall is one step.

    ``STATE`` declares what is remembered of one phone; zeros are a phone of whom nothing is known.
    """

    @property
    def STATE(self) -> np.dtype[np.void]:  # noqa: N802
        """Of one phone; all zeros: nothing known yet."""

    def advance(self, state: State, hops: Hops) -> Steps:
        """Take one hop of each of p phones, change ``state`` (p,) in place and return the steps it led to."""
