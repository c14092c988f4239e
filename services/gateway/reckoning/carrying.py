"""Is a phone of which nobody has told in the hand or in a pocket? Its swing with the thigh tells."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from services.gateway.reckoning.hops import Array, State

__all__ = ["Carrying", "CarryingDetection"]

Carrying = Literal["hand", "pocket", "bag", "unknown"]


class CarryingDetection:
    """In a pocket while the gyroscope's RMS, in the last seconds of walking, is above 1 rad/s.

    A thigh swings by some 20° about once a second, that is 1 to 2 rad/s; a hand that holds a phone to look at it turns
    by a fifth of it. A phone without gyroscope counts as held.
    """

    STATE = np.dtype([("power", np.float64), ("seconds", np.float64)])
    LEAST = 1.0
    """rad/s."""
    MEMORY = 4.0
    """Seconds of walking."""

    def advance(self, state: State, rate: Array, walking: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Take one hop (p, HOP, 3) rad/s of p phones; return (p,) which are in a pocket."""
        power = np.einsum("pni,pni->p", rate, rate) / rate.shape[1]
        seconds = np.where(walking, np.minimum(state["seconds"] + 1.0, self.MEMORY), state["seconds"])
        gain = np.where(walking, 1.0 / np.maximum(seconds, 1.0), 0.0)
        state["power"] += gain * (power - state["power"])
        state["seconds"] = seconds
        pocket: NDArray[np.bool_] = state["power"] > self.LEAST**2
        return pocket
