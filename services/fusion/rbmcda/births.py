"""Where may a phone be that was heard for the first time? Anywhere on the floor, in view or not, as its radio says.

A device is born *out of view*: as the Gaussian that has the mean and the covariance of what its first scan leaves of a
grid over the floor. Whether it is one of the people in view is for the association to say. A phone heard without any
access point of the floor is not born yet [ravel-thesis §6.3: postponed birth].
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["birth"]

Array = NDArray[np.float64]


def birth(
    grid: Array, expected: Array, reading: Array, noise: Array, bias: Array, usual: Array
) -> tuple[Array, Array, float]:
    """Return mean (2 + M,) and covariance (2 + M, 2 + M) of [position, biases] after one scan, and its log-likelihood.

    Args:
        grid: (g, 2) places, all alike likely before it.
        expected: (g, M) dBm there.
        reading: (M,) dBm; NaN where not heard.
        noise: (M,) variance of the readings, dB².
        bias: (M, M) covariance of the biases before it.
        usual: (M,) their mean.
    """
    heard = np.flatnonzero(np.isfinite(reading))
    residual = (reading - usual)[heard] - expected[:, heard]
    spread = bias[heard[:, None], heard] + np.diag(noise[heard])
    precision = np.linalg.inv(spread)
    solved = residual @ precision
    level = -0.5 * np.einsum("gh,gh->g", residual, solved)
    highest = float(level.max())
    weight = np.exp(level - highest)
    total = float(weight.sum())
    _, log_det = np.linalg.slogdet(2.0 * math.pi * spread)
    evidence = highest + math.log(total / len(weight)) - 0.5 * float(log_det)
    weight /= total
    gain = bias[:, heard]
    states = np.concatenate([grid, usual + solved @ gain.T], axis=1)
    mean = weight @ states
    apart = states - mean
    covariance = (apart * weight[:, None]).T @ apart
    covariance[2:, 2:] += bias - gain @ precision @ gain.T
    return mean, covariance, evidence
