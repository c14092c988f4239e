"""Who else was about? The tracks of one time, and, beside one of them, where the others went."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.learning.tracks.stretch import SAME
from shared.messages import TrackFrame

__all__ = ["Crowd", "followed_in", "others_of"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

MOST = 64
"""Other tracks told of, the nearest ones …"""
EVERY = 1.0
"""… and seconds between two of their places."""


@dataclass(frozen=True)
class Crowd:
    """Everybody who was followed at one time: (n,) track ids in ascending order, (n, 2) where they were, metres."""

    t: float
    track: Integers
    place: Array

    def row_of(self, track: int) -> int | None:
        """Return where in the columns a track is; None if it was not about."""
        row = int(np.searchsorted(self.track, track))
        return row if row < len(self.track) and self.track[row] == track else None


def followed_in(frame: TrackFrame) -> tuple[list[int], Integers, Array]:
    """Return the rows of a frame's tracks that are not followed by radio alone, by id; their ids and places (n, 2)."""
    rows = [row for row, state in enumerate(frame.state) if state != "unseen"]
    rows.sort(key=lambda row: frame.track[row])
    places = np.array([(frame.x[row], frame.y[row]) for row in rows], float).reshape(-1, 2)
    return rows, np.array([frame.track[row] for row in rows], np.int64), places


def others_of(crowds: Iterable[Crowd], track: int, t: Array, place: Array) -> tuple[Integers, Array, Array]:
    """Return ids (m,), times (k,) and places (m, k, 2) of the tracks nearest to one; NaN where one was not about.

    Args:
        crowds: in order of time.
        track: the one.
        t: (n,) s, ascending.
        place: (n, 2) metres, where it was then.
    """
    during: list[Crowd] = []
    for crowd in crowds:
        due = not during or crowd.t >= during[-1].t + EVERY - SAME
        if due and t[0] - SAME <= crowd.t <= t[-1] + SAME:
            during.append(crowd)
    if not during:
        return np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 0, 2))
    ids = np.unique(np.concatenate([crowd.track for crowd in during]))
    times = np.array([crowd.t for crowd in during])
    places = np.full((len(ids), len(during), 2), np.nan)
    for number, crowd in enumerate(during):
        places[np.searchsorted(ids, crowd.track), number] = crowd.place
    own = np.column_stack([np.interp(times, t, place[:, axis]) for axis in (0, 1)])
    away = ((places - own) ** 2).sum(axis=2)
    alive = np.isfinite(away)
    score = np.where(alive, away, 0.0).sum(axis=1) / np.maximum(alive.sum(axis=1), 1)
    score[ids == track] = np.inf
    nearest = np.sort(np.argsort(score, kind="stable")[: min(MOST, len(ids) - int((ids == track).any()))])
    return ids[nearest], times, places[nearest]
