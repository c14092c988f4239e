"""Which of these moments are far enough from the one before? The refractory time of many phones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.gateway.reckoning.hops import Array

__all__ = ["CLOCK_STEP", "spaced"]

CLOCK_STEP = 1e-5
"""s; what a clock that counts from 1970 cannot tell apart is no difference."""


def spaced(phone: NDArray[np.int64], t: Array, last: Array, gap: Array) -> NDArray[np.bool_]:
    """Return which of m moments, (m,), come at least ``gap`` after the last one kept of their phone.

    Args:
        phone: (m,) rows, ascending.
        t: (m,) s, ascending for each phone.
        last: (p,) s, when each phone's last one was, 0 where there was none; becomes that of the last one kept.
        gap: (p,) s.
    """
    kept = np.zeros(len(phone), bool)
    turn = np.arange(len(phone)) - np.searchsorted(phone, phone)
    for rank in range(int(turn.max(initial=-1)) + 1):
        now = np.flatnonzero(turn == rank)
        rows = phone[now]
        now = now[(last[rows] <= 0.0) | (t[now] - last[rows] >= gap[rows] - CLOCK_STEP)]
        last[phone[now]] = t[now]
        kept[now] = True
    return kept
