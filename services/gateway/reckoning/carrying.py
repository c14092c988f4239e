"""Is a phone of which nobody has told in the hand or in a pocket? How it lies and how it swings tell."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from services.gateway.reckoning.hops import Array, State

__all__ = ["Carrying", "CarryingDetection"]

Carrying = Literal["hand", "pocket", "bag", "unknown"]


class CarryingDetection:
    """In a pocket while, in the last seconds of walking, the screen does not face up and the phone swings.

    Who looks at a phone has its screen's upward part above a half (above 0.97 in 99 % of the walking seconds of the
    shopping-mall traces, above 0.75 on the twin); in the twin's trouser pockets it is below 0.45. A phone held upright
    before the face or at the ear does not swing as a thigh does: turning aside, a thigh's angular rate has an RMS above
    0.5 rad/s. Swing alone would not do, for a phone held flat bounces by as much. Phones without gyroscope count as
    held.
    """

    STATE = np.dtype([("power", np.float64), ("screen", np.float64), ("seconds", np.float64)])
    SCREEN_UP = 0.6
    SWING = 0.4
    """rad/s, about level axes."""
    MEMORY = 4.0
    """Seconds of walking."""

    def advance(self, state: State, rate: Array, attitude: Array, walking: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Take one hop of p phones, change ``state`` (p,) in place and return which are in a pocket, (p,).

        Args:
            state: (p,) of ``STATE``.
            rate: (p, HOP, 3) rad/s, bias removed.
            attitude: (p, HOP, 3, 3) rotations from the phone's axes to (east, north, up).
            walking: (p,) only these are learned from.
        """
        level = np.einsum("pnij,pnj->pni", attitude[:, :, :2], rate)
        power = np.einsum("pni,pni->p", level, level) / rate.shape[1]
        state["seconds"] = np.minimum(state["seconds"] + walking, self.MEMORY)
        gain = np.where(walking, 1.0 / np.maximum(state["seconds"], 1.0), 0.0)
        state["power"] += gain * (power - state["power"])
        state["screen"] += gain * (attitude[:, :, 2, 2].mean(axis=1) - state["screen"])
        pocket: NDArray[np.bool_] = (state["power"] > self.SWING**2) & (state["screen"] < self.SCREEN_UP)
        return pocket
