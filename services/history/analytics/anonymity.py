"""How many people is it at least? What fewer than five have done is not told; a track is not a person."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["TRACKS_PER_PERSON", "surely"]

TRACKS_PER_PERSON = 5
"""So many tracks has somebody without a known phone at one place: 5.0 in 40 minutes (``atrium bench visits``).

A measured mean, no bound: who stays in view for hours is found more often.
"""


def surely(people: NDArray[np.int64], known: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return as how many people ``people`` count who are to be hidden among them.

    Args:
        people: phones' carriers and tracks without a known phone.
        known: how many of them carry a known phone: each is one person.
    """
    return known + (people - known) // TRACKS_PER_PERSON
