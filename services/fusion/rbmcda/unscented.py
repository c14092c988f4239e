"""A bank of unscented filters as arrays [ravel-thesis §6.2, §16]: any number of states in the trailing axes.

The state is a position and a bias of every access point: [x, y, b_1 .. b_M]. The measurement of one device is the
composite [x, y, RSS_1(x) + b_1, .. RSS_M(x) + b_M]. Only the position enters nonlinearly, so that five sigma points do;
and a Gaussian composite may be taken in one after the other, radio first and the camera's part after it, exactly. The
bank does so, because a scan is then worked on once and not once per detection. ``filterpy`` with whole composites and
the sigma points of all 2 + M dimensions gives the same numbers; the tests hold it beside.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

__all__ = ["camera_update", "radio_update", "sigma_points"]

Array = NDArray[np.float64]

SPREAD = 3.0
"""n + kappa of two dimensions with alpha 1, kappa 1 and beta 2."""
MEAN_WEIGHTS = (1.0 / 3.0, 1.0 / 6.0, 1.0 / 6.0, 1.0 / 6.0, 1.0 / 6.0)
CENTRE = 1.0 / 3.0 + 2.0
"""Weight of the central point in covariances."""


def sigma_points(mean: Array, covariance: Array) -> Array:
    """Return the five sigma points (5, 2, ...) of positions: mean (2, ...), covariance (2, 2, ...)."""
    xx, xy, yy = covariance[0, 0], covariance[0, 1], covariance[1, 1]
    first = np.sqrt(SPREAD * xx)
    slant = SPREAD * xy / first
    second = np.sqrt(np.maximum(SPREAD * yy - slant**2, 0.0))
    points = np.broadcast_to(mean, (5, *mean.shape)).copy()
    points[1, 0] += first
    points[1, 1] += slant
    points[2, 1] += second
    points[3, 0] -= first
    points[3, 1] -= slant
    points[4, 1] -= second
    return points


def radio_update(
    mean: Array,
    covariance: Array,
    expected: Callable[[Array], Array],
    reading: Array,
    noise: Array,
) -> tuple[Array, Array, Array]:
    """Take in one scan per state.

    Args:
        mean: (2 + M, ...) states.
        covariance: (2 + M, 2 + M, ...).
        expected: from positions (n, 2) in metres to signal strengths (n, M) in dBm.
        reading: (M, ...) dBm; NaN where an access point was not heard.
        noise: (M, ...) variance of the readings, dB².

    Returns:
        the states and covariances after it, and (...) log N(reading; predicted), over what was heard.
    """
    trailing = mean.shape[1:]
    count = reading.shape[0]
    points = sigma_points(mean[:2], covariance[:2, :2])
    places = np.moveaxis(points, 1, -1).reshape(-1, 2)
    level = np.moveaxis(expected(places).reshape(5, *trailing, count), -1, 1)
    centre = level[0] * MEAN_WEIGHTS[0] + (level[1] + level[2] + level[3] + level[4]) * MEAN_WEIGHTS[1]
    apart = level - centre
    heard = np.isfinite(reading)
    # Opposite points give the slope H of the regression on the position: Cov(h(x), x) = H P.
    odd_first, odd_second = level[1] - level[3], level[2] - level[4]
    first, slant, second = points[1, 0] - mean[0], points[1, 1] - mean[1], points[2, 1] - mean[1]
    slope = np.empty((count, 2, *trailing))
    slope[:, 1] = odd_second / np.maximum(2.0 * second, 1e-12)
    slope[:, 0] = (odd_first - 2.0 * slope[:, 1] * slant) / (2.0 * first)
    # Cov(state, y): by way of the position, and by way of the reading's own bias.
    cross = np.empty((2 + count, count, *trailing))
    for j in range(count):
        cross[:, j] = covariance[:, 0] * slope[j, 0] + covariance[:, 1] * slope[j, 1] + covariance[:, 2 + j]
    innovation = np.where(heard, reading - centre - mean[2:], 0.0)
    spread = np.empty((count, count, *trailing))
    for j in range(count):
        # Cov(b, y) + H Cov(x, b) + Cov(h(x)).
        spread[:, j] = cross[2:, j]
        spread[:, j] += slope[:, 0] * covariance[0, 2 + j] + slope[:, 1] * covariance[1, 2 + j]
        spread[:, j] += CENTRE * apart[0] * apart[0, j]
        spread[:, j] += MEAN_WEIGHTS[1] * sum(apart[k] * apart[k, j] for k in range(1, 5))
        spread[j, j] += noise[j]
    # A missing reading becomes one that says nothing.
    present = heard.astype(np.float64)
    spread *= present[:, None] * present[None]
    for j in range(count):
        spread[j, j] += 1.0 - present[j]
    cross *= present
    whitened, rest, log_det = _eliminate(spread, np.concatenate([cross.swapaxes(0, 1), innovation[:, None]], axis=1))
    misfit = (rest**2).sum(axis=0)
    updated = mean + np.einsum("js...,j...->s...", whitened, rest)
    narrowed = covariance.copy()
    for i in range(2 + count):
        narrowed[i, i:] -= np.einsum("j...,jk...->k...", whitened[:, i], whitened[:, i:])
        narrowed[i:, i] = narrowed[i, i:]
    number = present.sum(axis=0)
    return updated, narrowed, -0.5 * (misfit + log_det + number * math.log(2.0 * math.pi))


def camera_update(mean: Array, covariance: Array, place: Array, noise: Array) -> tuple[Array, Array]:
    """Take in one detection per state.

    Args:
        mean: (s, ...) states, the position first.
        covariance: (s, s, ...).
        place: (2, ...) metres.
        noise: (2, 2, ...) m².
    """
    xx = covariance[0, 0] + noise[0, 0]
    xy = covariance[0, 1] + noise[0, 1]
    yy = covariance[1, 1] + noise[1, 1]
    lower = np.sqrt(xx)
    slant = xy / lower
    other = np.sqrt(yy - slant**2)
    first = covariance[:, 0] / lower
    second = (covariance[:, 1] - slant * first) / other
    dx = (place[0] - mean[0]) / lower
    dy = (place[1] - mean[1] - slant * dx) / other
    updated = mean + first * dx + second * dy
    narrowed = covariance - first[:, None] * first[None] - second[:, None] * second[None]
    return updated, narrowed


def _eliminate(matrix: Array, right: Array) -> tuple[Array, Array, Array]:
    """Return L⁻¹ of all but the last column of ``right``, L⁻¹ of the last, and log det, where ``matrix`` = L Lᵀ.

    Args:
        matrix: (m, m, ...) symmetric, positive; overwritten.
        right: (m, k, ...); overwritten.
    """
    count = len(matrix)
    log_det = np.zeros(matrix.shape[2:])
    for i in range(count):
        pivot = matrix[i, i]
        log_det += np.log(pivot)
        root = 1.0 / np.sqrt(pivot)
        right[i] *= root
        if i + 1 < count:
            row = matrix[i, i + 1 :] * root
            matrix[i + 1 :, i + 1 :] -= row[:, None] * row[None]
            right[i + 1 :] -= row[:, None] * right[i][None]
    return right[:, :-1], right[:, -1], log_det
