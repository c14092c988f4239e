"""How far does a step lead? By how briskly the thigh swings [nonvisual-visual-fusion-dissertation §2.4, Eq. 3.3].

A phone in the pocket turns faster the faster its carrier walks: the range of its angular rate over a stride, times a
factor that some twenty seconds of walking over a known distance tell.
"""

from __future__ import annotations

import numpy as np

from services.gateway.reckoning.hops import Array, State
from services.gateway.reckoning.recent import Recent
from services.gateway.reckoning.strides import FOOTFALLS, gather, strides
from services.gateway.steps.detector import Steps

__all__ = ["SwingLength", "swing_range"]


class SwingLength:
    """Lengths of steps of phones in pockets, once calibrated.

    The range is taken over the stride that ends with a step, not over the step: one phone lies on one thigh, which does
    not do in both halves of a stride the same.
    """

    STATE = np.dtype([("footfalls", FOOTFALLS), ("swung", np.float64), ("scale", np.float64)])

    def advance(self, state: State, recent: Recent, steps: Steps) -> Array:
        """Return the length of each of m steps, metres, and change ``state`` (p,) of ``STATE`` in place.

        NaN where the phone is not calibrated or the stride is not known.
        """
        found = strides(state["footfalls"], recent, steps)
        swing = np.where(found.known, swing_range(gather(recent.rate, recent, steps.phone, found)), np.nan)
        np.add.at(state["swung"], steps.phone, np.nan_to_num(swing))
        scale = state["scale"][steps.phone]
        return np.where(scale > 0.0, scale * swing, np.nan)

    def calibrate(self, state: State, distance: Array) -> None:
        """Take the steps since the last calibration (or ever) as ``distance`` (p,) metres; NaN leaves a phone as it is.

        Raises:
            ValueError: a distance is not positive, or a phone has not walked.
        """
        given = np.isfinite(distance)
        if (distance[given] <= 0.0).any():
            raise ValueError(f"distance is {distance[given].min():g} m, allowed is more than 0 m")
        if (state["swung"][given] <= 0.0).any():
            raise ValueError("a phone to be calibrated has made no step since the last calibration")
        state["scale"][given] = distance[given] / state["swung"][given]
        state["swung"][given] = 0.0


def swing_range(rate: Array) -> Array:
    """Return greatest less least norm of angular rates (m, n, 3), rad/s."""
    size = np.linalg.norm(rate, axis=2)
    spread: Array = size.max(axis=1) - size.min(axis=1)
    return spread
