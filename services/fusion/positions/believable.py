"""Which detections, and which covariances of theirs, can be worked with?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["believable", "limits", "usable"]

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

LEAST_VARIANCE = 1e-8
"""m²: no camera places anybody to a tenth of a millimetre."""
LARGEST = 1e100
"""m²: products of larger ones may be no numbers any more."""
FLATTEST = 1e-9
"""Of xx yy, the least determinant: a flatter ellipse is singular once rounded, and a filter fed with it ends in NaN."""


def believable(packed: Array) -> Flags:
    """Return (n,) which of (n, 3) covariances (xx, xy, yy), m², are finite ellipses with an inside."""
    xx, xy, yy = packed.T
    with np.errstate(invalid="ignore", over="ignore", under="ignore"):
        good: Flags = np.isfinite(packed).all(axis=1) & (xx > LEAST_VARIANCE) & (yy > LEAST_VARIANCE)
        return good & _has_inside(xx, xy, yy)


def limits(lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return least and largest values (6, 1) of x, y, xx, xy, yy and confidence that ``usable`` accepts.

    Args:
        lower: (2,) and ``upper``: (2,), corners of the floor, metres.
        upper: see there.
    """
    variance = float(np.nextafter(LEAST_VARIANCE, 1.0))
    least = np.array([*lower, variance, -LARGEST, variance, -LARGEST])
    return least[:, None], np.array([*upper, LARGEST, LARGEST, LARGEST, LARGEST])[:, None]


def usable(columns: Array, least: Array, largest: Array) -> Flags:
    """Return (n,) which detections are on the floor, with believable covariances.

    Args:
        columns: (6, n): x, y in metres, covariance xx, xy, yy in m², confidence.
        least: (6, 1) and ``largest``: (6, 1), their ``limits``.
        largest: see there.
    """
    good: Flags = np.logical_and.reduce((columns >= least) & (columns <= largest), axis=0)
    if np.count_nonzero(good) < len(good):
        columns = np.where(good, columns, 0.0)
    return good & _has_inside(*columns[2:5])


def _has_inside(xx: Array, xy: Array, yy: Array) -> Flags:
    square = xx * yy
    inside: Flags = square - xy * xy > FLATTEST * square
    return inside
