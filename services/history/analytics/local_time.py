"""Steps of a site's local time: days begin at its midnight, also where a day has 23 or 25 hours."""

from __future__ import annotations

import datetime
from zoneinfo import ZoneInfo

import numpy as np
from numpy.typing import NDArray

__all__ = ["by_step", "step_edges"]


def step_edges(since: float, until: float, step: int, time_zone: str) -> NDArray[np.float64]:
    """Return where steps begin, and last where the last one ends; shape (n + 1,), s.

    The first begins at or before ``since``, the last ends at or after ``until``; each local midnight begins one, so
    that the last of a day may be shorter, and a whole day longer, where clocks change.

    Args:
        since: seconds since the epoch.
        until: likewise, later.
        step: seconds, at most a day.
        time_zone: IANA name.
    """
    zone = ZoneInfo(time_zone)
    day = datetime.datetime.fromtimestamp(since, zone).date()
    edges: list[NDArray[np.float64]] = []
    midnight = _midnight(day, zone)
    while midnight < until:
        day += datetime.timedelta(days=1)
        following = _midnight(day, zone)
        of_day = np.arange(midnight, following, step)
        edges.append(of_day[:1] if step == 86400 else of_day)  # a day of 25 hours is one step all the same
        midnight = following
    starts = np.concatenate(edges)
    all_edges = np.append(starts, midnight)
    first = int(np.searchsorted(all_edges, since, side="right")) - 1
    last = int(np.searchsorted(all_edges, until, side="left"))
    return all_edges[first : last + 1]


def by_step(
    edges: NDArray[np.float64],
    t: NDArray[np.float64],
    counts: NDArray[np.int64],
    total: NDArray[np.int64],
    most: NDArray[np.int64],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the mean and the greatest number per step, NaN and -1 where nothing was counted.

    Args:
        edges: shape (n + 1,), from ``step_edges``.
        t: when minutes began, shape (m,), each within the edges.
        counts: how often was counted in each.
        total: the sum of what was counted.
        most: the greatest count.
    """
    steps = len(edges) - 1
    place = np.searchsorted(edges, t, side="right") - 1
    weights = np.bincount(place, counts, minlength=steps)
    sums = np.bincount(place, total, minlength=steps)
    mean = np.divide(sums, weights, out=np.full(steps, np.nan), where=weights > 0)
    greatest = np.full(steps, -1, np.int64)
    np.maximum.at(greatest, place, most)
    return mean, greatest


def _midnight(day: datetime.date, zone: ZoneInfo) -> float:
    return datetime.datetime.combine(day, datetime.time(), zone).timestamp()
