"""Who is too fast, and who is too near whom? Arrays of the people inside of one zone in, rows out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.special import ndtri

__all__ = ["too_fast", "too_near"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def too_fast(velocity: Floats, limit: float) -> Ints:
    """Return the rows of (n, 2) velocities, m/s, that are faster than ``limit``."""
    return np.flatnonzero(np.hypot(velocity[:, 0], velocity[:, 1]) > limit)


def too_near(
    place: Floats, covariance: Floats, limit: float, confidence: float, hazard: NDArray[np.bool_] | None = None
) -> tuple[Ints, Ints, Floats]:
    """Return the pairs of people that are probably nearer to each other than ``limit``.

    Args:
        place: (n, 2) metres.
        covariance: (n, 3) xx, xy, yy in m².
        limit: metres.
        confidence: how probable it must be, taking the two as they are measured: along the line between them. Who
            are known worse than the limit are near nobody.
        hazard: (n,) whether each is a hazard: then only pairs of one and somebody who is none; None: any two.

    Returns:
        one: (m,) row; of a hazard's pair, the person.
        other: (m,) row.
        distance: (m,) metres.
    """
    if len(place) < 2:
        none = np.empty(0, np.int64)
        return none, none, np.empty(0)
    pairs = KDTree(place).query_pairs(limit, output_type="ndarray").reshape(-1, 2).astype(np.int64)
    one, other = pairs[:, 0], pairs[:, 1]
    if hazard is not None:
        mixed = hazard[one] != hazard[other]
        one, other = one[mixed], other[mixed]
        one, other = np.where(hazard[one], other, one), np.where(hazard[one], one, other)
    between = place[other] - place[one]
    distance = np.hypot(between[:, 0], between[:, 1])
    along = between / np.maximum(distance, 1e-9)[:, None]
    spread = covariance[one] + covariance[other]
    variance = (
        along[:, 0] ** 2 * spread[:, 0]
        + 2.0 * along[:, 0] * along[:, 1] * spread[:, 1]
        + along[:, 1] ** 2 * spread[:, 2]
    )
    sigma = np.sqrt(np.maximum(variance, 0.0))
    near = (limit - distance >= float(ndtri(confidence)) * sigma) & (sigma <= limit)
    return one[near], other[near], distance[near]
