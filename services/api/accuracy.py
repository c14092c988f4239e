"""How surely is a place known, in one number?"""

from __future__ import annotations

import math

from shared.messages import Covariance

__all__ = ["accuracy_of"]


def accuracy_of(covariance: Covariance) -> float:
    """Return the standard deviation along the direction that is known worst, metres; ``covariance``: xx, xy, yy."""
    xx, xy, yy = covariance
    middle, half = (xx + yy) / 2.0, (xx - yy) / 2.0
    return round(math.sqrt(max(middle + math.hypot(half, xy), 0.0)), 3)
