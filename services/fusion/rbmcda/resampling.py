"""When do too few particles count, and which go on?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["effective", "systematic"]

Array = NDArray[np.float64]


def effective(weights: Array) -> Array:
    """Return N_eff = 1 / Σ w², (X,), of (N, X) weights that sum to one over the first axis."""
    number: Array = 1.0 / (weights**2).sum(axis=0)
    return number


def systematic(weights: Array, draws: Array) -> NDArray[np.int64]:
    """Return (N, X) which particle each new one goes on from [ravel-thesis §6.4].

    Args:
        weights: (N, X), summing to one over the first axis.
        draws: (X,) uniform in [0, 1).
    """
    count, columns = weights.shape
    levels = np.cumsum(weights, axis=0)
    levels[-1] = 1.0
    # One sorted search for all columns: column k lives between 2 k and 2 k + 1.
    apart = 2.0 * np.arange(columns)
    points = (draws + np.arange(count)[:, None]) / count
    found = np.searchsorted((levels + apart).T.ravel(), (points + apart).T.ravel(), side="right")
    rows: NDArray[np.int64] = np.clip(found.reshape(columns, count).T - count * np.arange(columns), 0, count - 1)
    return rows
