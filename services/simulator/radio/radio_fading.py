"""How does received power waver in time? Small-scale fading of a link, flicker of the air, drift of a transmitter.

None of it is white: who stands still hears the same again and again, and is off by the same amount each time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import exp1

__all__ = ["CHANNELS", "Drift", "Fading", "rice_mean"]

Array = NDArray[np.float64]

CHANNELS = 3
"""Advertising channels of Bluetooth Low Energy, far enough apart in frequency to fade each by itself."""

_DRAWN = 256  # points of a drift that are drawn at once
_DEEPEST = 1e-4  # power of the deepest fade relative to the mean: other reflections always remain


def rice_mean(factor: float) -> float:
    """Return the mean in dB of Rician fading of unit mean power: 10 log10(e) (ln(K / (K + 1)) + E1(K))."""
    if factor < 1e-9:
        return -10.0 / math.log(10.0) * float(np.euler_gamma)
    return 10.0 / math.log(10.0) * (math.log(factor / (factor + 1.0)) + float(exp1(factor)))


class Fading:
    """Small-scale (Rician) fading of one phone's links, and a flicker on top: processes along the phone's way.

    The scattered waves of each link and channel are complex Gaussian and stay alike over ``length`` metres of movement
    and ``time`` seconds; added to a steady wave K times as strong they give fades of a few dB, deep ones now and then.
    An access point is heard on one channel, a beacon on another one of three each time.

    Args:
        rng: draws everything, in order: any cut of a way into blocks gives the same fading.
        factor: K of each link, (k,).
        hops: whether a link's channel changes from reading to reading, (k,).
        length: metres.
        time: seconds.
        flicker_sigma: dB.
        flicker_time: seconds.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        factor: Array,
        hops: NDArray[np.bool_],
        length: float,
        time: float,
        flicker_sigma: float,
        flicker_time: float,
    ) -> None:
        self._waves, self._air, self._hop = rng.spawn(3)
        self._hops = hops
        self._length, self._time = length, time
        self._flicker_sigma, self._flicker_time = flicker_sigma, flicker_time
        self._steady = np.sqrt(factor / (factor + 1.0))
        self._scattered = np.sqrt(0.5 / (factor + 1.0))
        self._mean = np.array([rice_mean(one) for one in factor])
        links = len(factor)
        self._channels = CHANNELS if hops.any() else 1
        self._state = self._waves.standard_normal((links, self._channels, 2))
        self._flicker = self._air.standard_normal(links)
        self._last: tuple[float, Array, int] | None = None

    def along(self, t: Array, points: Array, floor: NDArray[np.int64]) -> Array:
        """Return what fading adds in dB, (n, k), mean zero, at times (n,) and plan points (n, 2) of floors (n,).

        Times never decrease, from call to call either.
        """
        count, links = len(t), len(self._steady)
        if not count:
            return np.zeros((0, links))
        if self._last is None:
            self._last = (float(t[0]), points[0].copy(), int(floor[0]))
        before_t, before_place, before_floor = self._last
        elapsed = np.diff(t, prepend=before_t).clip(0.0)
        moved = np.hypot(*np.diff(points, axis=0, prepend=before_place[None]).T)
        moved[np.diff(floor, prepend=before_floor) != 0] = np.inf
        self._last = (float(t[-1]), points[-1].copy(), int(floor[-1]))
        waves = _recur(
            np.exp(-moved / self._length - elapsed / self._time),
            self._state,
            self._waves.standard_normal((count, links, self._channels, 2)),
        )
        if self._channels == 1:
            chosen = waves[:, :, 0]
        else:
            channel = np.where(self._hops, self._hop.integers(0, CHANNELS, (count, links)), 0)
            chosen = np.take_along_axis(waves, channel[:, :, None, None], axis=2)[:, :, 0]
        power = (self._steady + self._scattered * chosen[..., 0]) ** 2 + (self._scattered * chosen[..., 1]) ** 2
        air = _recur(np.exp(-elapsed / self._flicker_time), self._flicker, self._air.standard_normal((count, links)))
        faded: Array = 10.0 * np.log10(np.maximum(power, _DEEPEST)) - self._mean + self._flicker_sigma * air
        return faded


class Drift:
    """A slow drift of each transmitter, the same for all phones: Ornstein-Uhlenbeck processes, functions of time.

    Args:
        rngs: draw them in order of time, one for each of k transmitters; used here only.
        sigma: standard deviation, dB.
        time: seconds after which their correlation is 1/e.
    """

    def __init__(self, rngs: Sequence[np.random.Generator], sigma: float, time: float) -> None:
        self._rngs = rngs
        self._sigma = sigma
        self._step = time / 20.0
        self._kept = math.exp(-1.0 / 20.0)
        self._table: Array = self._fresh(1)

    def at(self, t: Array) -> Array:
        """Return the drifts in dB, (n, k), at world times (n,) >= 0 (before that, what they are at 0)."""
        place = np.maximum(t, 0.0) / self._step
        while len(t) and place.max() >= len(self._table) - 1:
            grown = _recur(np.full(_DRAWN, self._kept), self._table[-1].copy(), self._fresh(_DRAWN))
            self._table = np.concatenate([self._table, grown])
        row = place.astype(np.int64)
        part = (place - row)[:, None]
        drift: Array = self._sigma * (self._table[row] * (1.0 - part) + self._table[row + 1] * part)
        return drift

    def _fresh(self, count: int) -> Array:
        drawn = np.empty((count, len(self._rngs)))
        for column, rng in enumerate(self._rngs):
            drawn[:, column] = rng.standard_normal(count)
        return drawn


def _recur(kept: Array, state: Array, fresh: Array) -> Array:
    """Return the first-order autoregression state' = kept · state + √(1 - kept²) · fresh at each step.

    Args:
        kept: (n,), correlation with the step before.
        state: (...), before the first step; left as after the last.
        fresh: (n, ...), standard normal; overwritten by the result.
    """
    fresh *= np.sqrt(1.0 - kept**2).reshape(-1, *[1] * state.ndim)
    for row, share in zip(fresh, kept.tolist(), strict=True):
        row += share * state
        state[...] = row
    return fresh
