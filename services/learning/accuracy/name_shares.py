"""How many of the names that were told are right? The share that best explains what came afterwards.

Of each name there is what fusion told, p, and how much likelier what the phone said in the next seconds is with the
name right than with it wrong. No single one need be decided: the shares are those of a mixture (EM; Dempster, Laird
and Rubin, 1977), one for each band of p, drawn to the told p by a few names' worth where little has come yet.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["right_probabilities"]

Array = NDArray[np.float64]

BANDS = (0.6, 0.75, 0.9)
"""Borders of the told p's bands."""
PRIOR = 24.0
"""Names that the told p counts for in a band: many, since names told soon after one another stand or
fall together."""
MISLED = 0.05
"""Share of the names for which what comes afterwards misleads: tracks pass from one person to another, bodies turn."""
ROUNDS = 60


def right_probabilities(told: Array, ratio: Array) -> Array:
    """Return the probability (n,) of each name being right.

    Args:
        told: (n,) p as fusion said.
        ratio: (n,) log of the likelihood of what came afterwards if the name is right, over that if it is wrong.
    """
    band = np.searchsorted(BANDS, told)
    odds = np.exp(np.clip(ratio, -50.0, 50.0))
    odds = ((1.0 - MISLED) * odds + MISLED) / (MISLED * odds + 1.0 - MISLED)
    probability = np.zeros(len(told))
    for number in np.unique(band):
        mine = band == number
        mean = float(told[mine].mean())
        share = mean
        for _ in range(ROUNDS):
            right = share * odds[mine] / (share * odds[mine] + 1.0 - share)
            share = float(right.sum() + PRIOR * mean) / (len(right) + PRIOR)
        probability[mine] = share * odds[mine] / (share * odds[mine] + 1.0 - share)
    return probability
