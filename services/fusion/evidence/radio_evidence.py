"""How much does one scan say for each place the device may be at?

What an access point reads beyond the path-loss model is

    device offset + shadowing of the place, the carrier's body, slow fading + quick noise.

The offset is unknown but the same for all access points: it is marginalised. The rest hardly changes while a person
stands still, so that a scan is new evidence only in so far as the phone has moved or much time has gone by since the
one before: its **novelty**. A scan's log-likelihood counts by its novelty; so repeated readings at one place say next
to nothing, whatever their rate. As all hypotheses of a device are weighed alike, nothing but the places decides.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["novelty", "scan_likelihood"]

Array = NDArray[np.float64]

OUTLIER = 3.0
"""Standard deviations; what is farther off says no more."""


def novelty(elapsed: float, walked: float, memory: float, reach: float) -> float:
    """Return how much of a scan is new, 0 to 1.

    Args:
        elapsed: seconds since the scan before; infinity for none.
        walked: metres since.
        memory: seconds after which a still phone's readings are 1/e alike.
        reach: metres after which a walking one's are.
    """
    return 1.0 - math.exp(-elapsed / memory - walked / reach)


def scan_likelihood(residual: Array, variance: Array, offset: float, offset_variance: float) -> Array:
    """Return the log-likelihood (n,) of one scan at n places, the device's offset marginalised.

    Args:
        residual: (n, h) or (..., h), heard minus expected there, dB.
        variance: of each, dB²; broadcastable.
        offset: what the device is believed to read too much, dB, and its variance, dB².
        offset_variance: see there.
    """
    limit = OUTLIER * np.sqrt(variance + offset_variance)
    off = residual - offset
    np.minimum(np.maximum(off, -limit, out=off), limit, out=off)
    weight = 1.0 / variance
    total = weight.sum(axis=-1)
    # Sums over the few access points of thousands of cells: products summed at once, nothing stored between.
    shared = np.einsum("...h,...h->...", off, weight)
    squares = np.einsum("...h,...h,...h->...", off, off, weight)
    misfit = squares - shared * shared / (1.0 / offset_variance + total)
    volume = np.log(variance).sum(axis=-1) + np.log1p(offset_variance * total)
    likelihood: Array = -0.5 * (misfit + volume)
    return likelihood
