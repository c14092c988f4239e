"""What does the gyroscope tell while the phone does not turn? [self-calibrating-rss-thesis §3.1]."""

from __future__ import annotations

import numpy as np

from services.gateway.reckoning.hops import HOP, Array, Hops, State

__all__ = ["GyroBias"]


class GyroBias:
    """The mean of the gyroscope over the seconds in which the phone lay still, subtracted.

    A second counts as still where neither acceleration nor rotation vary beyond their noise and the rotation is no more
    than a bias can be. The bias belongs to the phone and is kept where a walk ends.

    The thesis measures it once, in a trial phase; here every rest is one.
    """

    STATE = np.dtype([("bias", np.float64, (3,)), ("seconds", np.float64)])
    ACCELERATION_SIGMA = 0.10
    """m/s², of the norm; sensor noise is 0.02-0.05."""
    RATE_SIGMA = 0.012
    """rad/s, of each axis; sensor noise is 0.002-0.006."""
    LARGEST = 0.08
    """rad/s; consumer gyroscopes are off by less (1000 °/h are 0.005 rad/s, cheap ones have 3 °/s)."""
    MEMORY = 30.0
    """Seconds of rest that the mean goes back: a bias wanders with the phone's warmth."""

    def advance(self, state: State, hops: Hops) -> Array:
        """Take one hop of each of p phones, change ``state`` (p,) in place; return (p, HOP, 3) rad/s without bias."""
        norm = np.sqrt(np.einsum("pni,pni->pn", hops.acceleration, hops.acceleration))
        mean = hops.rotation.mean(axis=1)
        still = (
            (hops.count == HOP)
            & (norm.std(axis=1) < self.ACCELERATION_SIGMA)
            & (hops.rotation.std(axis=1) < self.RATE_SIGMA).all(axis=1)
            & (np.abs(mean) < self.LARGEST).all(axis=1)
        )
        seconds = np.minimum(state["seconds"] + still, self.MEMORY)
        gain = np.where(still, 1.0 / np.maximum(seconds, 1.0), 0.0)[:, None]
        state["bias"] += gain * (mean - state["bias"])
        state["seconds"] = seconds
        rate: Array = hops.rotation - state["bias"][:, None]
        return rate
