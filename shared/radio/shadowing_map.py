"""What the path-loss model gets wrong at each place, per access point, and how sure that is: a grid of residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["ShadowingMap"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ShadowingMap:
    """Residuals of m access points on a grid; outside the grid the nearest cell speaks.

    Attributes:
        names: (m,) site ids of the access points.
        origin: (2,) the centre of the first cell, metres.
        cell: side of a cell, metres.
        mean: (m, rows, columns) heard minus expected, dB.
        variance: (m, rows, columns) of what remains unknown there, of the path-loss constants too, dB².
    """

    names: tuple[str, ...]
    origin: Array
    cell: float
    mean: Array
    variance: Array

    def at(self, places: Array) -> tuple[Array, Array]:
        """Return mean (n, m) in dB and variance (n, m) in dB² at (n, 2) places, bilinear between cells."""
        mean, variance = self._blended(places, slice(None))
        return mean.T, variance.T

    def of(self, places: Array, access_point: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return mean (…, n) in dB and variance (…, n) in dB² at (…, n, 2) places, of one access point each, (n,)."""
        return self._blended(places, access_point)

    def _blended(self, places: Array, which: NDArray[np.int64] | slice) -> tuple[Array, Array]:
        rows, columns = self.mean.shape[1:]
        spot = (places - self.origin) / self.cell
        x = np.minimum(np.maximum(spot[..., 0], 0.0), columns - 1.0)
        y = np.minimum(np.maximum(spot[..., 1], 0.0), rows - 1.0)
        left, below = x.astype(np.int64), y.astype(np.int64)
        right, above = np.minimum(left + 1, columns - 1), np.minimum(below + 1, rows - 1)
        u, v = x - left, y - below

        def blend(grid: Array) -> Array:
            low = (1.0 - u) * grid[which, below, left] + u * grid[which, below, right]
            high = (1.0 - u) * grid[which, above, left] + u * grid[which, above, right]
            blended: Array = (1.0 - v) * low + v * high
            return blended

        return blend(self.mean), blend(self.variance)
