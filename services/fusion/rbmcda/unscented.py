"""A bank of unscented filters as arrays [ravel-thesis §6.2, §16]: any number of states in the trailing axis.

The state is a position and a bias of every access point: [x, y, b_1 .. b_M]. The measurement of one device is the
composite [x, y, RSS_1(x) + b_1, .. RSS_M(x) + b_M]. Only the position enters nonlinearly, so that five sigma points do;
and a Gaussian composite may be taken in one after the other, radio first and the camera's part after it, exactly. The
bank does so, because a scan is then worked on once and not once per detection. ``filterpy`` with whole composites and
the sigma points of all 2 + M dimensions gives the same numbers; the tests hold it beside.

Updates write into the arrays they are given, a block of states at a time that stays in the processor's cache.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

__all__ = ["BLOCK", "camera_update", "radio_update", "sigma_points"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

SPREAD = 3.0
"""n + kappa of two dimensions with alpha 1, kappa 1 and beta 2."""
EVEN_SUM, EVEN_DIFFERENCE = math.sqrt(5.0 / 18.0), math.sqrt(1.0 / 6.0)
"""What the weights of the sigma points (1/3, central 1/3 + 2 in covariances, the others 1/6) make of the sum and of the
difference of the two axes' curvatures: their outer products are all of Cov(h(x)) that H P Hᵀ leaves out."""
BLOCK = 384
"""States worked on at a time."""


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
    owner: Indices,
) -> Array:
    """Take in one scan per device, in place.

    Args:
        mean: (2 + M, u) states, overwritten.
        covariance: (2 + M, 2 + M, u), overwritten.
        expected: from positions (n, 2) in metres to signal strengths (n, M) in dBm.
        reading: (M, X) dBm; NaN where an access point was not heard.
        noise: (M, X) variance of the readings, dB².
        owner: (u,) whose state each is.

    Returns:
        (u,) log N(reading; predicted), over what was heard.
    """
    evidence = np.zeros(len(owner))
    alike: dict[bytes, list[int]] = {}
    for device, pattern in enumerate(np.isfinite(reading).T):
        if pattern.any():
            alike.setdefault(pattern.tobytes(), []).append(device)
    for devices in alike.values():
        heard = np.flatnonzero(np.isfinite(reading[:, devices[0]]))
        states = np.flatnonzero(np.isin(owner, devices))
        for begin in range(0, len(states), BLOCK):
            block = _span(states[begin : begin + BLOCK])
            place = np.ix_(heard, owner[block])
            x, p = mean[:, block].copy(), covariance[:, :, block].copy()
            evidence[block] = _radio_block(x, p, expected, heard, reading[place], noise[place])
            mean[:, block], covariance[:, :, block] = x, p
    return evidence


def _span(places: Indices) -> slice | Indices:
    """Return ascending ``places`` as a slice where they are all in a row, which is quicker to copy."""
    first, last = int(places[0]), int(places[-1])
    return slice(first, last + 1) if last - first + 1 == len(places) else places


def _radio_block(
    mean: Array, covariance: Array, expected: Callable[[Array], Array], heard: Indices, reading: Array, noise: Array
) -> Array:
    """Take in (h, k) readings of the ``heard`` access points, in place; return (k,) their log-likelihoods."""
    size, count = mean.shape
    number, biases = len(heard), 2 + heard
    points = sigma_points(mean[:2], covariance[:2, :2])
    places = points.transpose(0, 2, 1).reshape(-1, 2)
    middle, *around = expected(places)[:, heard].T.reshape(number, 5, count).swapaxes(0, 1)
    # Opposite points give the slope H of the regression on the position: Cov(h(x), x) = H P.
    slope_y = (around[1] - around[3]) / np.maximum(2.0 * (points[2, 1] - mean[1]), 1e-12)
    slope_x = (around[0] - around[2] - slope_y * (2.0 * (points[1, 1] - mean[1]))) / (2.0 * (points[1, 0] - mean[0]))
    bend_x, bend_y = 0.5 * (around[0] + around[2]) - middle, 0.5 * (around[1] + around[3]) - middle
    total, apart = EVEN_SUM * (bend_x + bend_y), EVEN_DIFFERENCE * (bend_x - bend_y)
    # Cov(y, state), by way of the position and by way of the reading's own bias; and what was not foreseen.
    right = np.empty((number, size + 1, count))
    cross = right[:, :size]
    cross[...] = covariance[biases]
    cross += slope_x[:, None] * covariance[0]
    cross += slope_y[:, None] * covariance[1]
    right[:, size] = reading - middle - (bend_x + bend_y) / SPREAD - mean[biases]
    # Cov(y, b) + Cov(y, x) Hᵀ + what is not linear + noise.
    spread = cross[:, biases]
    spread += cross[:, 0, None] * slope_x
    spread += cross[:, 1, None] * slope_y
    spread += total[:, None] * total
    spread += apart[:, None] * apart
    spread[np.arange(number), np.arange(number)] += noise
    log_det = _eliminate(spread, right)
    misfit = np.einsum("jk,jk->k", right[:, size], right[:, size])
    mean += np.einsum("jsk,jk->sk", cross, right[:, size])
    for row in range(size):
        covariance[row, row:] -= np.einsum("jk,jsk->sk", cross[:, row], cross[:, row:])
        covariance[row + 1 :, row] = covariance[row, row + 1 :]
    evidence: Array = -0.5 * (misfit + log_det + number * math.log(2.0 * math.pi))
    return evidence


def camera_update(mean: Array, covariance: Array, place: Array, noise: Array) -> None:
    """Take in one detection per state, in place.

    Args:
        mean: (s, k) states, the position first; overwritten.
        covariance: (s, s, k), overwritten.
        place: (2, k) metres.
        noise: (2, 2, k) m².
    """
    xx = covariance[0, 0] + noise[0, 0]
    xy = covariance[0, 1] + noise[0, 1]
    yy = covariance[1, 1] + noise[1, 1]
    lower = np.sqrt(xx)
    slant = xy / lower
    other = np.sqrt(yy - slant**2)
    first = covariance[0] / lower
    second = (covariance[1] - slant * first) / other
    dx = (place[0] - mean[0]) / lower
    dy = (place[1] - mean[1] - slant * dx) / other
    mean += first * dx + second * dy
    covariance -= first[:, None] * first
    covariance -= second[:, None] * second


def _eliminate(matrix: Array, right: Array) -> Array:
    """Turn (m, r, k) ``right`` into L⁻¹ of it and return (k,) log det, where ``matrix`` (m, m, k) = L Lᵀ is lost."""
    count = len(matrix)
    log_det = np.zeros(matrix.shape[2])
    for i in range(count):
        pivot = matrix[i, i]
        log_det += np.log(pivot)
        root = 1.0 / np.sqrt(pivot)
        right[i] *= root
        if i + 1 < count:
            row = matrix[i, i + 1 :] * root
            matrix[i + 1 :, i + 1 :] -= row[:, None] * row
            right[i + 1 :] -= row[:, None] * right[i]
    return log_det
