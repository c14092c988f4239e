"""How strongly did the body bounce with each step? What the universal stride model asks of a phone in the hand."""

from __future__ import annotations

import numpy as np

from services.gateway.reckoning.hops import RATE, Array
from services.gateway.reckoning.recent import KEPT, Recent
from services.gateway.steps.detector import Steps
from shared.walking.stride import BOUNCE_WINDOW, USUAL_CADENCE

__all__ = ["bounce"]

REACH = int(0.5 * BOUNCE_WINDOW * RATE)
_k = np.arange(-REACH, REACH + 1)
_taper = np.hanning(2 * REACH + 3)[1:-1]
_wave = np.exp(-2j * np.pi * USUAL_CADENCE * _k / RATE)
# Of a constant the tapered wave sees a little; taken away, gravity does not count.
KERNEL = _taper * (_wave - np.sum(_taper * _wave) / np.sum(_taper)) / np.sum(_taper)


def bounce(recent: Recent, steps: Steps) -> Array:
    """Return the peak to peak of the acceleration's norm at the rhythm of steps, about each of m steps, (m,) m/s².

    The taper is one second long, so that all cadences of walking are heard and harder strikes of the heel are not.
    Where samples are not there yet, or no more, the nearest one stands for them.
    """
    middle = recent.index(steps.phone, steps.t)
    first = np.maximum(KEPT - recent.count[steps.phone], 0)
    window = np.clip(middle[:, None] + _k, first[:, None], KEPT - 1)
    norm = np.linalg.norm(recent.acceleration[steps.phone[:, None], window], axis=2)
    swing: Array = 4.0 * np.abs(norm @ KERNEL)
    return swing
