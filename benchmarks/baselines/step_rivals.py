"""The step detectors that the HMM of the RAVEL thesis was compared with [ravel-thesis §9, Table A.1].

They see a whole recording at once, which a service cannot; each has one threshold. The thesis names them and no more.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, find_peaks, sosfiltfilt

from services.gateway.reckoning.hops import RATE
from services.gateway.steps.rhythm import rhythm

__all__ = ["RIVALS", "THRESHOLDS", "correlation", "peak_detection", "zero_crossing"]

Array = NDArray[np.float64]
Rival = Callable[[Array, float], Array]

SPACING = 0.3
"""s between steps."""


def peak_detection(acceleration: Array, threshold: float) -> Array:
    """Return the times of steps, s after the first sample: maxima of the norm, low-passed at 3 Hz, above a threshold.

    Args:
        acceleration: (n, 3) m/s², gravity included, at ``RATE``.
        threshold: m/s² above the mean.
    """
    wave = _filtered(acceleration, (0.3, 3.0))
    return find_peaks(wave, height=threshold, distance=int(SPACING * RATE))[0] / RATE


def zero_crossing(acceleration: Array, threshold: float) -> Array:
    """Return the times of steps, s after the first sample: upward zero crossings of the norm, band-passed.

    Args:
        acceleration: as above.
        threshold: m/s², RMS over the second around, below which the phone is at rest.
    """
    wave = _filtered(acceleration, (0.6, 3.0))
    strength = np.sqrt(np.convolve(wave**2, np.full(int(RATE), 1.0 / RATE), mode="same"))
    up = 1 + np.flatnonzero((wave[:-1] <= 0.0) & (wave[1:] > 0.0))
    t = up[strength[up] > threshold] / RATE
    return t[np.diff(t, prepend=-np.inf) >= SPACING]


def correlation(acceleration: Array, threshold: float) -> Array:
    """Return the times of steps, s after the first sample: even ones, where the norm repeats itself, one a period.

    Args:
        acceleration: as above.
        threshold: autocorrelation of three seconds, judged each half second.
    """
    wave = _filtered(acceleration, (0.6, 3.0))
    size, hop = int(3.0 * RATE), int(0.5 * RATE)
    padded = np.pad(wave, size // 2)
    starts = np.arange(0, len(wave) - hop, hop)
    windows = padded[starts[:, None] + np.arange(size)]
    period, agreement = rhythm(windows)
    walks = (agreement > threshold) & (windows.std(axis=1) > 0.3) & (period > 0.0)
    phase = np.cumsum(np.where(walks, 0.5 / np.maximum(period, 0.1), 0.0))
    count = np.arange(1, int(phase[-1]) + 1)
    return np.interp(count, np.concatenate([[0.0], phase]), np.append(starts, starts[-1] + hop) / RATE)


def _filtered(acceleration: Array, band: tuple[float, float]) -> Array:
    norm = np.linalg.norm(acceleration, axis=1)
    wave: Array = sosfiltfilt(butter(2, band, "bandpass", fs=RATE, output="sos"), norm - norm.mean())
    return wave


RIVALS: dict[str, Rival] = {"peaks": peak_detection, "zero_crossing": zero_crossing, "correlation": correlation}
THRESHOLDS: dict[str, tuple[float, ...]] = {
    "peaks": (0.3, 0.5, 0.7, 1.0, 1.4),
    "zero_crossing": (0.3, 0.5, 0.7, 1.0, 1.4),
    "correlation": (0.3, 0.4, 0.5, 0.6, 0.7, 0.8),
}
"""Those to choose from."""
