"""How strongly did the body bounce with each step? What the universal stride model asks of a phone in the hand."""

from __future__ import annotations

import numpy as np

from services.gateway.reckoning.hops import RATE, Array
from services.gateway.reckoning.recent import KEPT, Recent
from services.gateway.steps.detector import Steps
from shared.walking.stride import BOUNCE_WINDOW

__all__ = ["bounce"]

REACH = int(0.5 * BOUNCE_WINDOW * RATE)


def bounce(recent: Recent, steps: Steps) -> Array:
    """Return the range of the acceleration's norm about each of m steps, (m,) m/s².

    Samples that are not there yet, or no more, are left out.
    """
    middle = recent.index(steps.phone, steps.t)
    first = np.maximum(KEPT - recent.count[steps.phone], 0)
    window = np.clip(middle[:, None] + np.arange(-REACH, REACH + 1), first[:, None], KEPT - 1)
    norm = np.linalg.norm(recent.acceleration[steps.phone[:, None], window], axis=2)
    spread: Array = (norm.max(axis=1) - norm.min(axis=1)).astype(float)
    return spread
