"""When is somebody surely on the other side of a border? Log-odds of each sample, gathered over time.

A sample that lies ``z`` standard deviations beyond a border speaks for the other side with log Φ(z) - log Φ(-z) nats.
Their sum, never below nothing, is the test that decides soonest at a given rate of false decisions (Page 1954, CUSUM).
It is counted in shares of what is needed: samples that leave no doubt bring all of it within the least time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["SURE", "gathered", "lingering"]

Floats = NDArray[np.float64]

SURE = 2.0
"""Standard deviations beyond margin and border from which on somebody is surely there."""
_NO_DOUBT = 4.0
"""Nats that one sample speaks at most."""
_AT_ONCE = 5.0
"""Standard deviations beyond the border at which nothing more is waited for."""
_ONE_SAMPLE = 0.5
"""Of what is needed: no less than two samples decide, however rare they are."""
_LINGERS, _LINGERING = 0.5, 2.0
"""By how much, and in units of how many seconds, more is needed of whoever lingers."""


def gathered(evidence: Floats, z: Floats, seconds: Floats, min_seconds: float | Floats) -> Floats:
    """Return the evidence (m,) of being on the other side after one more sample; 1 and more: enough.

    Args:
        evidence: (m,) before.
        z: (m,) by how many standard deviations the sample lies on the other side.
        seconds: (m,) for which the sample stands: since the one before.
        min_seconds: for which somebody must surely be there; one for all, or (m,).
    """
    bounded = np.clip(z, -_AT_ONCE, _AT_ONCE)
    # Bowling et al. 2009: the logit of the normal distribution function, 1e-4 near.
    log_odds = np.clip(bounded * (1.5976 + 0.07056 * bounded * bounded), -_NO_DOUBT, _NO_DOUBT) / _NO_DOUBT
    share = np.minimum(log_odds * seconds / np.maximum(min_seconds, 1e-9), _ONE_SAMPLE)
    return np.where(z >= _AT_ONCE, 1.0, np.maximum(evidence + share, 0.0))


def lingering(seconds: Floats) -> Floats:
    """Return by how much more (m,) is needed of those who have been beside a border for so long without a decision.

    They are asked anew with every sample, and noise says yes some day. Where what is needed grows with the logarithm
    of the time, the chance of that shrinks by a power of it: its sum over all time is small (alpha spending, Lan and
    DeMets 1983).
    """
    more: Floats = 1.0 + _LINGERS * np.log1p(np.maximum(seconds, 0.0) / _LINGERING)
    return more
