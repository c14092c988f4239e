"""How much are many readings of one visit to a spot worth? By how much visits to the same spot disagree.

While a phone stays about a spot its readings share an error that no further reading takes away: how the carrier faces,
where the phone is held, who stands beside, and, where a name was wrong, that somebody else was there. How large it is,
visits of one spot show: they disagree by more than their readings' own noise explains. This is the random-effects model
of trials that are pooled (DerSimonian and Laird, 1986).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["visit_variance"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]


def visit_variance(spot: Index, visit: Index, residual: Array, weight: Array) -> float:
    """Return the variance, dB², of what all readings of a visit have in common; 0 where visits agree or none can tell.

    Args:
        spot: (n,) which access point and spot a reading is of.
        visit: (n,) which visit to it, 0 … v − 1.
        residual: (n,) heard − expected, the phone's own offset taken off, dB.
        weight: (n,) inverse variance of each reading by itself, dB⁻²; more than 0.
    """
    if not len(visit):
        return 0.0
    total = np.bincount(visit, weight)
    level = np.bincount(visit, weight * residual) / total
    where = np.zeros(len(total), np.int64)
    where[visit] = np.unique(spot, return_inverse=True)[1].ravel()
    together = np.bincount(where, total)
    mean = np.bincount(where, total * level) / together
    beyond = float(np.sum(total * (level - mean[where]) ** 2)) - (len(total) - len(together))
    scale = float(np.sum(total) - np.sum(np.bincount(where, total**2) / together))
    return max(beyond / scale, 0.0) if scale > 0.0 else 0.0
