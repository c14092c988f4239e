"""One device's way: its points in order, one place at a time, thinned."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["one_way"]


def one_way(t: NDArray[np.float64], probability: NDArray[np.float64], step: float) -> NDArray[np.int64]:
    """Return which points make one way, in the order of time.

    Two areas that overlap may both tell of a moment: the more probable counts.

    Args:
        t: when, shape (n,), s.
        probability: of the device being there, shape (n,).
        step: seconds between two points at least; 0: all.
    """
    order = np.lexsort((-probability, t))
    key = t[order] if step <= 0.0 else np.floor(t[order] / step)
    return order[np.unique(key, return_index=True)[1]]
