"""Which way does somebody walk who holds the phone in the hand? The way it points, averaged over a stride."""

from __future__ import annotations

import numpy as np

from services.gateway.reckoning.hops import RATE, Array, State
from services.gateway.reckoning.recent import KEPT, Recent
from services.gateway.reckoning.step_heading import StepHeadings
from services.gateway.steps.detector import Steps

__all__ = ["HandHeading", "pointing"]

REACH = int(0.5 * RATE)


def pointing(attitude: Array) -> Array:
    """Return where phones point, horizontally, (..., 2) east and north: along the top, or away from an upright screen.

    Args:
        attitude: (..., 3, 3) rotations from the phone's axes to (east, north, up).
    """
    upright = attitude[..., 2, 1:2] > HandHeading.UPRIGHT
    return np.where(upright, -attitude[..., :2, 2], attitude[..., :2, 1])


class HandHeading:
    """The mean direction of the phone over a stride about each step: its sway cancels."""

    STATE = np.dtype([("steps", np.int64)])
    UPRIGHT = 0.8
    """Upward part of the phone's top above which it is held upright."""
    BIAS_VARIANCE = np.radians(8.0) ** 2
    """rad², of what all steps of a walk have in common beside the compass's own doubt: grip, building, map."""
    STEP_VARIANCE = np.radians(30.0) ** 2
    """rad², of a step by itself. Neighbouring steps err alike, by 8° for a leg of a dozen: who adds them up as if each
    erred by itself is right about the sum with this much."""

    def advance(self, state: State, recent: Recent, steps: Steps) -> StepHeadings:
        """Return the headings of ``steps``; see ``StepHeading``."""
        middle = recent.index(steps.phone, steps.t)
        first = np.maximum(KEPT - recent.count[steps.phone], 0)
        window = np.clip(middle[:, None] + np.arange(-REACH, REACH + 1), first[:, None], KEPT - 1)
        ahead = pointing(recent.attitude[steps.phone[:, None], window]).mean(axis=1)
        heading = np.arctan2(ahead[:, 0], ahead[:, 1]).astype(float)
        bias = np.full(len(heading), self.BIAS_VARIANCE)
        return StepHeadings(heading, bias + self.STEP_VARIANCE, bias, heading, np.zeros(len(heading)))
