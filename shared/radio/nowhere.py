"""What are readings like where nobody knows places? What radio evidence is held against [ravel-thesis §6.5a].

Each access point has a level and a spread, wherever it is heard, and what is heard now is like what was heard a moment
ago: else any place would explain readings better than none, because readings of one place are alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Nowhere"]

Array = NDArray[np.float64]

MEMORY = 7.0
"""Seconds after which what somebody hears who is carried about is no longer like before."""
LEAST_SPREAD = 3.0
"""dB; nothing without places predicts a reading better."""


@dataclass(frozen=True)
class Nowhere:
    """Readings of m access points, wherever they are made, but for what a phone reads too much.

    Attributes:
        level: (m,) dBm, their mean.
        variance: (m,) dB², of what a phone hears for a while about it.
    """

    level: Array
    variance: Array

    @classmethod
    def of(cls, level: Array, variance: Array, white: float = 0.0, device: float = 0.0) -> Nowhere:
        """Return the model of readings by all phones with a mean and a variance.

        Args:
            level: (m,) dBm.
            variance: (m,) dB².
            white: dB², of it, by which one reading differs from the next.
            device: dB², of it, by which phones differ.
        """
        return cls(level, np.maximum(np.maximum(variance - device, LEAST_SPREAD**2) - white, 0.0))

    def covariance(self, t: Array, access_point: NDArray[np.int64], white: Array | float) -> Array:
        """Return (n, n) dB² of one phone's readings about ``level``.

        Args:
            t: (n,) s.
            access_point: (n,) which one each is of.
            white: (n,) dB² by which each differs from the next whatever it is of.
        """
        same = access_point[:, None] == access_point[None]
        spread = np.sqrt(self.variance[access_point])
        kept = np.exp(-np.abs(t[:, None] - t[None]) / MEMORY)
        covariance: Array = same * np.outer(spread, spread) * kept
        covariance[np.diag_indices(len(t))] += white
        return covariance
