"""Errors that last: noise of unit variance that wanders with a time constant, for columns that come and go."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

__all__ = ["Episodes", "Wander"]

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


class Wander:
    """First-order autoregressive noise, partly white; who was away for a block starts anew.

    Args:
        seconds: time constant of the part that wanders.
        interval: seconds between samples.
        wandering: share of the variance that wanders; the rest is white.
        rng: its own generator.
    """

    def __init__(self, seconds: float, interval: float, wandering: float, rng: np.random.Generator) -> None:
        self._keep = math.exp(-interval / max(seconds, 1e-9))
        self._wandering = wandering
        self._rng = rng
        self._last: dict[int, float] = {}

    def next(self, keys: Sequence[int], count: int) -> Array:
        """Return the next ``count`` samples (count, k) of the columns called ``keys``; unit variance."""
        if not keys or not count:
            return np.zeros((count, len(keys)))
        drawn = self._rng.standard_normal((count + 1, len(keys)))
        last = np.array([self._last.get(key, math.nan) for key in keys])
        # A new column draws what went before from the stationary distribution.
        before = np.where(np.isnan(last), drawn[0], last)
        keep = self._keep
        path, _ = lfilter([math.sqrt(1.0 - keep * keep)], [1.0, -keep], drawn[1:], axis=0, zi=keep * before[None])
        self._last = dict(zip(keys, path[-1].tolist(), strict=True))
        white = self._rng.standard_normal(path.shape)
        mixed: Array = math.sqrt(self._wandering) * path + math.sqrt(1.0 - self._wandering) * white
        return mixed


class Episodes:
    """A state that is on now and then: a two-state Markov chain per column.

    Args:
        per_s: how often it begins while it is off, per second.
        seconds: mean duration.
        interval: seconds between samples.
        rng: its own generator.
    """

    def __init__(self, per_s: float, seconds: float, interval: float, rng: np.random.Generator) -> None:
        self._on = 1.0 - math.exp(-per_s * interval)
        self._off = 1.0 - math.exp(-interval / max(seconds, 1e-9))
        if self._on + self._off > 1.0:
            # So coarse that it changes more often than it is looked at: what counts is how often it is on.
            self._on, self._off = self._on / (self._on + self._off), self._off / (self._on + self._off)
        self._rng = rng
        self._last: dict[int, bool] = {}

    def next(self, keys: Sequence[int], count: int) -> Bools:
        """Return the next ``count`` states (count, k) of the columns called ``keys``."""
        if not keys or not count:
            return np.zeros((count, len(keys)), bool)
        drawn = self._rng.random((count, len(keys)))
        before = np.array([self._last.get(key, False) for key in keys])
        # One draw says "on from here", "off from here" or "as before"; the last that was said holds.
        said = np.where(drawn < self._on, 1, np.where(drawn > 1.0 - self._off, 0, -1)).astype(np.int8)
        rows = np.where(said >= 0, np.arange(count)[:, None], -1)
        last = np.maximum.accumulate(rows, axis=0)
        states: Bools = np.where(last >= 0, np.take_along_axis(said, np.maximum(last, 0), axis=0) == 1, before)
        self._last = dict(zip(keys, states[-1].tolist(), strict=True))
        return states
