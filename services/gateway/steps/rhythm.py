"""How regularly does a wave repeat itself, and after what time? Step periods by autocorrelation, of many phones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from services.gateway.reckoning.hops import RATE, Array

__all__ = ["rhythm"]

LAGS = (int(0.28 * RATE), int(1.6 * RATE))
"""Samples from step to step, at least and at most."""
NEARLY_BEST = 0.85
"""Of the best correlation: steady walking repeats itself as well after two or three strides; the shortest lag wins."""
_REACH = LAGS[1] // 10


def rhythm(wave: Array) -> tuple[Array, Array]:
    """Return the step period, s, and the normalised autocorrelation at the lag at which the wave repeats itself.

    One foot may strike harder than the other, so that a wave repeats itself after a stride: where half of the lag is a
    peak of the correlation too, that is the period.

    Args:
        wave: (p, n) of p phones, without its mean.

    Returns:
        Both (p,); zeros where nothing repeats itself.
    """
    size = wave.shape[1]
    low, high = LAGS
    spectrum = rfft(wave, next_fast_len(size + high + 1, real=True), axis=1)
    product = irfft(np.abs(spectrum) ** 2, next_fast_len(size + high + 1, real=True), axis=1)[:, : high + 1]
    power = np.cumsum(wave**2, axis=1)
    whole = power[:, -1:]
    head = power[:, size - high - 2 : size - 1][:, ::-1]  # power of all but the last 1 .. high + 1 samples
    head = np.concatenate([whole, head[:, :high]], axis=1)
    tail = whole - np.concatenate([np.zeros_like(whole), power[:, :high]], axis=1)
    correlation = product / np.sqrt(np.maximum(head * tail, 1e-9))
    inner = correlation[:, low:high]
    top = (inner >= correlation[:, low - 1 : high - 1]) & (inner >= correlation[:, low + 1 : high + 1])
    best_value = np.where(top, inner, -np.inf).max(axis=1, keepdims=True)
    found = top & (inner >= NEARLY_BEST * best_value) & (best_value > 0.0)
    rows = np.arange(len(wave))
    best = low + np.argmax(found, axis=1)
    agreement = np.where(found.any(axis=1), correlation[rows, best], 0.0)
    best = _or_half(correlation, best)
    return np.where(agreement > 0.0, best / RATE, 0.0), agreement


def _or_half(correlation: Array, lag: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the lag of the correlation's peak near half of ``lag`` (p,) where there is one, else ``lag``."""
    rows = np.arange(len(lag))[:, None]
    offsets = np.arange(-_REACH, _REACH + 1)
    half = (lag // 2)[:, None]
    around = np.clip(half + offsets, 0, correlation.shape[1] - 1)
    near = np.where(np.abs(offsets) <= np.maximum(1, lag[:, None] // 10), correlation[rows, around], -np.inf)
    place = around[rows[:, 0], np.argmax(near, axis=1)]
    there, before, after = (correlation[rows[:, 0], np.maximum(place + step, 0)] for step in (0, -1, 1))
    return np.where((place >= LAGS[0]) & (there > before) & (there >= after), place, lag)
