"""What dead reckoning works on: hops, one second of evenly spaced samples, of many phones at a time.

Every algorithm of the rooms ``reckoning`` and ``steps`` is written the same way, so that five hundred phones cost
arrays and no Python per sample: it declares what it must remember of one phone as a NumPy structured ``dtype``,
``STATE``, in which **all zeros means that nothing is known yet**, and advances p phones by one hop each in one call.
The states of p phones are one structured array (p,), changed in place.

Since a hop is always whole, no result depends on how a phone cut its samples into batches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["HOP", "RATE", "Array", "Hops", "State"]

Array = NDArray[np.float64]
State = NDArray[np.void]
"""(p,) structured, of the algorithm's ``STATE``."""

RATE = 50.0
"""Hz; what all of dead reckoning works at."""
HOP = 50
"""Samples in a hop: one second."""


@dataclass(frozen=True, slots=True)
class Hops:
    """The next hop of each of p phones.

    Attributes:
        t: (p,) time of the first sample, phone clock, s; sample i is at ``t + i / RATE``.
        count: (p,) how many of the samples were measured, 1 to HOP. Fewer than HOP where a hole follows that is too
            long to bridge: the rest repeats the last sample and must lead to nothing.
        fresh: (p,) True where this hop does not continue the one before. Whoever calls has zeroed the states there.
        acceleration: (p, HOP, 3) m/s², gravity included, in the phone's axes (x right, y to the top, z out of the
            screen).
        rotation: (p, HOP, 3) rad/s; zeros where the phone has no gyroscope.
        field: (p, HOP, 3) µT; NaN where there is no compass.
    """

    t: Array
    count: NDArray[np.int64]
    fresh: NDArray[np.bool_]
    acceleration: Array
    rotation: Array
    field: Array

    def times(self) -> Array:
        """Return the time of every sample, (p, HOP) s."""
        return self.t[:, None] + np.arange(HOP) / RATE

    def measured(self) -> NDArray[np.bool_]:
        """Return which samples were measured, (p, HOP)."""
        return np.arange(HOP) < self.count[:, None]
