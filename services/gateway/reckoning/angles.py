"""Directions: how are they brought to length one?"""

from __future__ import annotations

import numpy as np

from services.gateway.reckoning.hops import Array

__all__ = ["unit"]


def unit(vectors: Array) -> Array:
    """Return vectors (..., n) of length one; those of no length stay."""
    length = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))
    directions: Array = vectors / np.maximum(length, 1e-12)[..., None]
    return directions
