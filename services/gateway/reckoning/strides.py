"""What did the phone measure during one stride? Windows of two footfalls, cut out for many steps at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.gateway.reckoning.hops import RATE, Array, State
from services.gateway.reckoning.recent import KEPT, Recent, Single
from services.gateway.steps.detector import Steps

__all__ = ["FOOTFALLS", "SAMPLES", "Strides", "gather", "rank", "strides"]

FOOTFALLS = np.dtype([("count", np.int64), ("t", np.float64, (2,))])
"""How many footfalls there were of one phone, and the times of the last two, s."""
SAMPLES = 32
"""Evenly spaced samples to which a stride is brought, so that its harmonics are whole bins of a DFT."""
SHORTEST, LONGEST = 0.6, 2.4
"""Seconds of a stride; two footfalls further apart are no stride."""


@dataclass(frozen=True, slots=True)
class Strides:
    """The strides that end with m steps.

    Attributes:
        begin: (m,) time of the footfall before the last, or where it should have been, s.
        end: (m,) time of the step, s.
        known: (m,) False where no stride is known to end here or not all of it is remembered.
    """

    begin: Array
    end: Array
    known: NDArray[np.bool_]


def rank(steps: Steps) -> NDArray[np.int64]:
    """Return for each of m steps how many of the same phone are before it."""
    count = np.arange(len(steps.phone))
    return count - np.searchsorted(steps.phone, steps.phone, side="left")


def strides(footfalls: State, recent: Recent, steps: Steps) -> Strides:
    """Return the stride of each step and remember the newest footfalls.

    Where the step before the last is not known, the stride is twice the step period.

    Args:
        footfalls: (p,) of ``FOOTFALLS``, changed in place.
        recent: tells what is still remembered.
        steps: those of the newest hop.
    """
    place, phone, t = rank(steps), steps.phone, steps.t
    before, count = footfalls["t"], footfalls["count"]
    one = np.where(place > 0, np.roll(t, 1), before[phone, 1])
    two = np.where(place > 1, np.roll(t, 2), np.where(place > 0, before[phone, 1], before[phone, 0]))
    newest = np.append(phone[1:] != phone[:-1], True) if len(phone) else np.zeros(0, bool)
    whole = (count[phone] + place >= 2) & _is_stride(t - two)
    begin = np.where(whole, two, t - 2.0 * steps.period[phone])
    oldest = recent.t[phone] - (recent.count[phone] - 1) / RATE
    before[phone[newest], 0], before[phone[newest], 1] = one[newest], t[newest]
    count[phone[newest]] += place[newest] + 1
    return Strides(begin, t, _is_stride(t - begin) & (begin >= oldest - 0.5 / RATE))


def gather(values: Single, recent: Recent, phone: NDArray[np.int64], found: Strides) -> Array:
    """Return ``values`` (p, KEPT, ...) of ``recent`` during m strides, interpolated: (m, SAMPLES, ...)."""
    share = np.arange(SAMPLES) / SAMPLES
    t = found.begin[:, None] + (found.end - found.begin)[:, None] * share
    place = np.clip(KEPT - 1 - (recent.t[phone, None] - t) * RATE, 0.0, KEPT - 1.001)
    low = place.astype(np.int64)
    part = (place - low).astype(np.float32).reshape(*place.shape, *[1] * (values.ndim - 2))
    at = phone[:, None]
    before = values[at, low]
    return (before + part * (values[at, low + 1] - before)).astype(np.float64)


def _is_stride(seconds: Array) -> NDArray[np.bool_]:
    return (seconds > SHORTEST) & (seconds < LONGEST)
