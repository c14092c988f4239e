"""Which covariances of detections can be worked with?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["believable"]

LEAST_VARIANCE = 1e-8
"""m²: no camera places anybody to a tenth of a millimetre."""
FLATTEST = 1e-9
"""Of xx yy, the least determinant: a flatter ellipse is singular once rounded, and a filter fed with it ends in NaN."""


def believable(packed: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return (n,) which of (n, 3) covariances (xx, xy, yy), m², are finite ellipses with an inside."""
    xx, xy, yy = packed.T
    with np.errstate(invalid="ignore", over="ignore", under="ignore"):
        good: NDArray[np.bool_] = np.isfinite(packed).all(axis=1) & (xx > LEAST_VARIANCE) & (yy > LEAST_VARIANCE)
        good &= xx * yy - xy * xy > FLATTEST * xx * yy
    return good
