"""How long is a step? The universal model, for people of whom nothing is known yet."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["step_length"]

LENGTH = 0.70
"""m. On the shopping-mall traces a constant errs by 6.1 % of a walk (median); no law of cadence did better there."""
USUAL_CADENCE = 1.86
"""Steps per second, ± 0.11 between people."""
SCALE_SIGMA = 0.10
"""Of a person's own mean step against the constant, as a share; with the spread of single steps inside one walk."""
CADENCE_SIGMA = 0.25
"""m per step/s: how much less is known of somebody who strolls or hurries."""


def step_length(cadence: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return lengths (m) and variances (m²) of steps taken at ``cadence`` (n,) steps per second."""
    sigma = SCALE_SIGMA * LENGTH + CADENCE_SIGMA * np.abs(cadence - USUAL_CADENCE)
    return np.full(len(cadence), LENGTH), np.minimum(sigma, 0.3) ** 2
