"""How much does what a camera saw speak for a track? A term of the incremental log-likelihood ratio.

[ravel-thesis §8.1, Eq. 5.1]: a detection of the track counts log N(detection; predicted, S) p_d / clutter, a look at
its place without one log(1 - p_d). Who scores decides what p_d and clutter are, which detection is the track's, and
what one look is worth.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["assigned_nats", "missed_nats", "off_by"]

Array = NDArray[np.float64]

LEAST_DETERMINANT = 1e-12
"""m⁴."""


def off_by(x: Array, y: Array, xx: Array, xy: Array, yy: Array) -> tuple[Array, Array]:
    """Return by how much detections are off, in squared standard deviations, and log |S|; all of one shape.

    Args:
        x: metres, detection less prediction, ``y`` likewise.
        y: see above.
        xx: m², S of both together, with ``xy`` and ``yy``.
        xy: see above.
        yy: see above.
    """
    determinant = np.maximum(xx * yy - xy * xy, LEAST_DETERMINANT)
    squared: Array = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant
    return squared, np.log(determinant)


def assigned_nats(squared: Array, log_determinant: Array, detected: float | Array, clutter: float | Array) -> Array:
    """Return what detections of tracks count, nats.

    Args:
        squared: standard deviations², as ``off_by`` says.
        log_determinant: likewise.
        detected: p_d.
        clutter: detections of nobody per m² and look.
    """
    nats: Array = np.log(detected / clutter) - 0.5 * (squared + log_determinant) - math.log(2.0 * math.pi)
    return nats


def missed_nats(detected: float) -> float:
    """Return what a look without a detection counts, nats."""
    return math.log(1.0 - detected)
