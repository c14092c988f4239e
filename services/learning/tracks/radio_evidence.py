"""How well do a phone's readings fit each of several paths? Nats, against a model of no places.

A reading differs from what is expected at its place by

    device + access point + shadowing + what hands and bodies do to a whole scan + quick noise,

all Gaussian. Shadowing changes as the phone is carried along: two readings are the less alike the farther it *walked*
between them, by its own steps, whoever's path it is held against. So one covariance serves all paths, and what differs
between them is the fit alone. Without places the same readings have the mean and spread that the access point has
wherever it is heard, and what is heard now is like what was heard a moment ago [ravel-thesis §6.5a].
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from shared.radio import Nowhere

__all__ = ["Fit", "Gathered", "RadioBelief", "gather", "radio_fit"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

BIN = 1.0
"""Seconds of which an access point's readings are averaged."""
SHADOWING, RANGE, MEMORY = 4.0, 3.0, 15.0
"""dB, and metres and seconds after which it is 1/e alike."""
WHITE = 2.0
"""dB, of one reading."""
COMMON = 2.0
"""dB, of all readings of a second."""


@dataclass(frozen=True)
class RadioBelief:
    """What earlier stretches tell of access points and of one device; arrays are (m,).

    Attributes:
        bias: dB by which each access point is heard beyond the model.
        bias_variance: dB², of it.
        device: dB by which the device reads too much, and ``device_variance`` dB².
        device_variance: see above.
        nowhere: each access point's readings wherever they are made.
    """

    bias: Array
    bias_variance: Array
    device: float
    device_variance: float
    nowhere: Nowhere


@dataclass(frozen=True)
class Gathered:
    """A device's readings, averaged by second and access point: (r,) each, in order of access point and time.

    Attributes:
        t: s.
        point: which access point.
        level: dBm.
        count: of readings.
        travelled: metres the phone had walked by then.
    """

    t: Array
    point: Integers
    level: Array
    count: Array
    travelled: Array


@dataclass(frozen=True)
class Fit:
    """Of k paths.

    Attributes:
        gain: (k,) nats, likelihood on the path minus that without places.
        chi2: (k,) sum of squared whitened residuals, of ``readings`` expected.
        readings: how many averages there were.
        offset: (k, m) dB by which each access point was heard beyond the model and belief; NaN where it was not.
        offset_variance: (m,) dB², of it, shadowing included.
        quick: dB, standard deviation of readings about those just before and after; NaN where too few tell.
    """

    gain: Array
    chi2: Array
    readings: int
    offset: Array
    offset_variance: Array
    quick: float


def gather(t: Array, point: Integers, level: Array, step_t: Array, length: Array) -> Gathered:
    """Return the averages of readings (r,) of a phone that took steps (s,) of some metres meanwhile."""
    second = np.floor(t / BIN).astype(np.int64)
    key, index = np.unique(np.column_stack([point, second]), axis=0, return_inverse=True)
    index = index.ravel()
    count = np.bincount(index).astype(np.float64)
    when = np.bincount(index, t) / np.maximum(count, 1.0)
    walked = np.concatenate([[0.0], np.cumsum(length)])
    return Gathered(
        when,
        key[:, 0],
        np.bincount(index, level) / np.maximum(count, 1.0),
        count,
        walked[np.searchsorted(step_t, when)] if len(when) else when,
    )


def radio_fit(heard: Gathered, expected: Array, belief: RadioBelief) -> Fit:
    """Return how well the readings fit k paths.

    Args:
        heard: the r averages.
        expected: (k, r) dBm that the model expects of them on each path.
        belief: what earlier stretches tell.
    """
    paths, points = len(expected), len(belief.bias)
    offset, offset_variance = np.full((paths, points), np.nan), np.full(points, np.inf)
    placed, nowhere = _Marginal(paths), _Marginal(1)
    squares, pairs = 0.0, 0
    borders = np.flatnonzero(np.diff(heard.point)) + 1
    for rows in np.split(np.arange(len(heard.point)), borders):
        if not len(rows):
            continue
        point = int(heard.point[rows[0]])
        t, travelled, count = heard.t[rows], heard.travelled[rows], heard.count[rows]
        apart = np.abs(t[:, None] - t)
        white = WHITE**2 / count + COMMON**2
        alike = np.exp(-np.abs(travelled[:, None] - travelled) / RANGE - apart / MEMORY)
        covariance = SHADOWING**2 * alike + np.diag(white)
        beyond = heard.level[rows] - expected[:, rows] - belief.bias[point]
        lower = np.linalg.cholesky(covariance)
        solved = solve_triangular(lower, np.column_stack([np.ones(len(rows)), beyond.T]), lower=True)
        placed.add(solved, float(np.log(np.diag(lower)).sum()), float(belief.bias_variance[point]))
        weight = float(solved[:, 0] @ solved[:, 0])
        offset[:, point], offset_variance[point] = solved[:, 0] @ solved[:, 1:] / weight, 1.0 / weight
        lower = np.linalg.cholesky(belief.nowhere.covariance(t, heard.point[rows], white))
        column = np.column_stack([np.ones(len(rows)), heard.level[rows] - belief.nowhere.level[point]])
        nowhere.add(solve_triangular(lower, column, lower=True), float(np.log(np.diag(lower)).sum()), 0.0)
        if len(rows) > 2:
            bend = heard.level[rows][1:-1] - 0.5 * (heard.level[rows][:-2] + heard.level[rows][2:])
            squares, pairs = squares + float(bend @ bend) / 1.5, pairs + len(bend)
    own, squared = placed.nats(belief.device, belief.device_variance)
    none, _ = nowhere.nats(belief.device, belief.device_variance)
    return Fit(
        gain=own - none[0],
        chi2=squared,
        readings=len(heard.t),
        offset=offset,
        offset_variance=offset_variance,
        quick=math.sqrt(squares / pairs) if pairs >= 20 else math.nan,
    )


class _Marginal:
    """Sums of k Gaussian log-likelihoods over access points, one offset common to all of them marginalised."""

    def __init__(self, paths: int) -> None:
        self._ones, self._half_log_det = 0.0, 0.0
        self._cross, self._squares = np.zeros(paths), np.zeros(paths)

    def add(self, solved: Array, half_log_det: float, own_variance: float) -> None:
        """Add an access point: whitened ones and residuals (r, 1 + k); its own offset, of a variance, goes as well."""
        ones, residual = solved[:, 0], solved[:, 1:]
        a, b, c = float(ones @ ones), ones @ residual, (residual**2).sum(axis=0)
        shrink = own_variance / (1.0 + own_variance * a)
        self._ones += a - shrink * a * a
        self._cross += b - shrink * a * b
        self._squares += c - shrink * b * b
        self._half_log_det += half_log_det + 0.5 * math.log1p(own_variance * a)

    def nats(self, mean: float, variance: float) -> tuple[Array, Array]:
        """Return log-likelihoods (k,) and sums of squares (k,), where the common offset has a mean and variance."""
        a = self._ones
        b = self._cross - mean * a
        c = self._squares - 2.0 * mean * self._cross + mean * mean * a
        squares = c - variance / (1.0 + variance * a) * b * b
        return -0.5 * squares - self._half_log_det - 0.5 * math.log1p(variance * a), squares
