"""What would be learned if an access point had changed that only seems to have: a model to be tried, not believed."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from services.learning.radio.changes import GONE, REACH, SHIFTED
from services.learning.radio.shifts import Shift
from shared.radio import Visits

__all__ = ["news_to", "supposed"]

Array = NDArray[np.float64]


def supposed(visits: Visits, kept: Array, shifts: Sequence[Shift]) -> tuple[Visits, Array]:
    """Return visits and (n,) how much of each stays, as ``Changes`` would have them were the shifts believed."""
    level, kept = visits.level.copy(), kept.copy()
    for shift in shifts:
        before = (visits.point == shift.point) & (visits.t < shift.since)
        if shift.whole:
            level[before] += shift.by
            kept[before] *= SHIFTED
        else:
            kept[before & _near(visits, shift)] *= GONE
    return dataclasses.replace(visits, level=level), kept


def news_to(visits: Visits, error: Array, shift: Shift) -> bool:
    """Whether a model with errors (n,), heard − foretold in dB, does not know of a shift yet."""
    mine = (visits.point == shift.point) & (visits.t > shift.since)
    if not shift.whole:
        mine &= _near(visits, shift)
    return bool(mine.any()) and float(np.median(error[mine])) / shift.by > 0.5


def _near(visits: Visits, shift: Shift) -> NDArray[np.bool_]:
    apart = visits.place[:, None] - shift.places[None]
    near: NDArray[np.bool_] = np.hypot(apart[..., 0], apart[..., 1]).min(axis=1, initial=np.inf) <= REACH
    return near
