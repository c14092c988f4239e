"""How fast do people walk? The same figures of a simulated crowd and of a recorded one, to be laid side by side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.simulator.people import BLOCK, People

__all__ = ["WalkingSpeeds", "walking_speeds"]

Array = NDArray[np.float64]

_MOVING = 0.3  # m/s: who is slower stands


@dataclass(frozen=True, slots=True)
class WalkingSpeeds:
    """Speeds of moving people, m/s.

    Attributes:
        mean, sd: over all instants and people.
        between: standard deviation of people's own means.
        within: root mean square deviation from one's own mean.
        quantiles: of 5, 25, 50, 75, 95 %, (5,).
        changes: root mean square change of speed from one interval to the next, m/s.
        people: how many were seen moving.
    """

    mean: float
    sd: float
    between: float
    within: float
    quantiles: Array
    changes: float
    people: int


def walking_speeds(people: People, start: float, end: float, interval: float = 0.4) -> WalkingSpeeds:
    """Return how fast people moved from ``start`` to ``end``, by their positions every ``interval`` seconds.

    Raises:
        ValueError: nobody moved.
    """
    speeds = np.concatenate(_blocks(people, start, end, interval))
    moving = np.where(speeds > _MOVING, speeds, np.nan)
    seen = np.isfinite(moving).sum(axis=0)
    if not seen.any():
        raise ValueError(f"nobody moved between {start:g} and {end:g} s")
    enough = seen >= 4
    chosen = moving[:, enough]
    own = np.nanmean(chosen, axis=0)
    every = moving[np.isfinite(moving)]
    return WalkingSpeeds(
        mean=float(every.mean()),
        sd=float(every.std()),
        between=float(own.std()),
        within=float(np.sqrt(np.nanmean((chosen - own) ** 2))),
        quantiles=np.quantile(every, [0.05, 0.25, 0.5, 0.75, 0.95]),
        changes=float(np.sqrt(np.nanmean(np.diff(moving, axis=0) ** 2))),
        people=int((seen > 0).sum()),
    )


def _blocks(people: People, start: float, end: float, interval: float) -> list[Array]:
    steps = max(2, round(BLOCK / interval))
    blocks = []
    for first in range(0, int((end - start) / interval), steps):
        times = np.asarray(start + interval * np.arange(first, first + steps + 1), np.float64)
        moved = people.movement(times)
        there = moved.present[1:] & moved.present[:-1] & (moved.floor[1:] == moved.floor[:-1])
        speed = np.hypot(*np.moveaxis(np.diff(moved.position, axis=0), -1, 0)) / interval
        blocks.append(np.where(there, speed, np.nan))
    return blocks
