"""Does somebody walk, or only handle the phone? The spectrum of each second [self-calibrating-rss-thesis §3.4]."""

from __future__ import annotations

import numpy as np

from services.gateway.reckoning.hops import HOP, Array, Hops, State

__all__ = ["WalkingDetection"]


class WalkingDetection:
    """Moving: a second whose norm of acceleration has a DFT coefficient above 20 at 1, 2 or 3 Hz (0.8 m/s²).

    Walking: moving for two seconds or longer; the disturbing acts of the thesis are shorter. This is the causal form:
    the second moving second confirms the walk and releases the first.

    On the step counter recordings that holds for 93 % of the seconds of walking and 13 % of the others; dead reckoning
    lets it speak only for who has also stepped within the last second.
    """

    STATE = np.dtype([("moving", np.int64)])
    """Seconds in which the phone has been moving without a pause."""
    THRESHOLD = 20.0
    SECONDS = 2

    def advance(self, state: State, hops: Hops) -> Array:
        """Take one hop of each of p phones; return (p,) since when each walks, s phone clock, NaN for who does not."""
        norm = np.sqrt(np.einsum("pni,pni->pn", hops.acceleration, hops.acceleration))
        moving = np.abs(np.fft.rfft(norm, axis=1)[:, 1:4]).max(axis=1) > self.THRESHOLD
        state["moving"] = np.where(moving & (hops.count == HOP), state["moving"] + 1, 0)
        begun = hops.t - (state["moving"] - 1)
        return np.where(state["moving"] >= self.SECONDS, begun, np.nan)
