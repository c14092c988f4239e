"""From a stretch to runs of steps that a camera watched: how far the track went meanwhile, and which way.

A track's place is wrong by two tenths of a metre and a step is seven tenths long, so that one step says little. Some
steps in a row say a lot, since a track's errors change slowly [ravel-thesis §8.3]. The way is taken along the track,
from step to step: straight from end to end it would be 5 % short, because people hardly ever walk straight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.learning.tracks.stretch import Stretch

__all__ = ["STEPS", "Runs", "runs_of"]

Array = NDArray[np.float64]

STEPS = 6
"""Of a run: four metres or so."""
INTERVALS = (0.3, 1.0)
"""Seconds between which a step follows the one before it; a longer pause is a missed step or a stop."""
DETOUR = 1.06
"""By which the way over the middle may be longer than the straight one in a run that leads one way."""
LEAST_WAY = 1.5
"""Metres; who goes less far in so many steps treads on the spot."""
HOLE = 0.5
"""Seconds at most between the two rows of a track around a step."""
DIRECTION_SIGMA = 0.15
"""Metres by which either end of a run is wrong across the way."""


@dataclass(frozen=True)
class Runs:
    """Of one stretch, m runs of ``STEPS`` steps each, one after the other.

    Attributes:
        t: (m,) when each ended, s.
        way: (m,) metres of the track for each step, the mean.
        cadence: (m,) steps per second, the mean over the steps of 1 / time since the step before, as the gateway takes
            it, so that ``slope x cadence + offset`` of the run is the mean of that of its steps.
        length: (m,) mean length of a step as published, metres.
        walk: (m,) which walk of the phone.
        turned: (m,) radians, published headings minus the way the track went, the circular mean; NaN where the run did
            not lead one way.
        turned_variance: (m,) rad², of the track's share in it.
    """

    t: Array
    way: Array
    cadence: Array
    length: Array
    walk: NDArray[np.int64]
    turned: Array
    turned_variance: Array


def runs_of(stretch: Stretch) -> Runs:
    """Return the runs of a stretch at all of whose steps a camera saw the track."""
    t, place = stretch.t[stretch.seen], stretch.place[stretch.seen]
    step_t = stretch.step_t
    after = np.searchsorted(t, step_t)
    inside = (after > 0) & (after < len(t))
    after = np.where(inside, after, 1)
    if len(t) < 2 or len(step_t) <= STEPS:
        return _table([])
    watched = inside & (t[after] - t[after - 1] <= HOLE)
    spots = np.column_stack([np.interp(step_t, t, place[:, axis]) for axis in (0, 1)])
    apart = np.diff(step_t)
    follows = (apart > INTERVALS[0]) & (apart < INTERVALS[1]) & (np.diff(stretch.walk) == 0)
    follows &= watched[1:] & watched[:-1]
    broken = np.flatnonzero(~follows)
    rows: list[tuple[float, ...]] = []
    first = 0
    while first + STEPS < len(step_t):
        breaks = broken[(broken >= first) & (broken < first + STEPS)]
        if len(breaks):
            first = int(breaks[-1]) + 1
            continue
        rows += _run(stretch, first, spots[first : first + STEPS + 1], apart[first : first + STEPS])
        first += STEPS
    return _table(rows)


def _run(stretch: Stretch, first: int, spots: Array, apart: Array) -> list[tuple[float, ...]]:
    of = slice(first + 1, first + STEPS + 1)
    way = float(np.hypot(*np.diff(spots, axis=0).T).sum())
    if way < LEAST_WAY:
        return []
    straight = spots[-1] - spots[0]
    middle = spots[STEPS // 2]
    over = float(np.hypot(*(middle - spots[0])) + np.hypot(*(spots[-1] - middle)))
    turned = np.nan
    if over <= DETOUR * np.hypot(*straight):
        direction = np.arctan2(straight[1], straight[0])
        turned = float(np.angle(np.exp(1j * (stretch.heading[of] - direction)).mean()))
    return [
        (
            float(stretch.step_t[first + STEPS]),
            way / STEPS,
            float(np.mean(1.0 / apart)),
            float(stretch.length[of].mean()),
            float(stretch.walk[first]),
            turned,
            2.0 * DIRECTION_SIGMA**2 / way**2,
        )
    ]


def _table(rows: list[tuple[float, ...]]) -> Runs:
    t, way, cadence, length, walk, turned, variance = np.array(rows, float).reshape(-1, 7).T
    return Runs(t, way, cadence, length, walk.astype(np.int64), turned, variance)
