"""Which track stands in which column, and where it was in the last seconds."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.fusion.snapshot import unpack
from services.fusion.walks.path_history import PathHistory

__all__ = ["Columns"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

BLOCK = 8
"""Columns are added in blocks."""


class Columns:
    """Tracks by column; a column is used again ``kept`` seconds after its track ended.

    Attributes:
        tracks: (k,), ids; 0 where a column is free.
        lost_at: (k,), when the track ended; infinity while it lives.
        place: (k, 2), where it was last; ``coasting``: (k,), whether no camera saw it then.
        history: where the columns' tracks were in the last seconds.
    """

    def __init__(self, kept: float) -> None:
        self.kept = kept
        self.tracks = np.zeros(0, np.int64)
        self.lost_at = np.zeros(0)
        self.place = np.zeros((0, 2))
        self.coasting = np.zeros(0, np.bool_)
        self.history = PathHistory()

    @property
    def alive(self) -> Integers:
        """Columns whose tracks live."""
        return np.flatnonzero((self.tracks > 0) & (self.lost_at == math.inf))

    def of(self, ids: Integers) -> Integers:
        """Return the column (n,) of each track id, all of which must be alive."""
        order = np.argsort(self.tracks, kind="stable")
        found: Integers = order[np.searchsorted(self.tracks, ids, sorter=order)]
        return found

    def find(self, track: int) -> int:
        """Return the column of a track, −1 where there is none."""
        found = np.flatnonzero(self.tracks == track)
        return int(found[0]) if track > 0 and len(found) else -1

    def follow(self, t: float, ids: Integers, places: Array, coasting: NDArray[np.bool_]) -> tuple[Integers, Integers]:
        """Note where the living tracks are; return the columns that ended and those that began.

        Args:
            t: the time, not before the last.
            ids: (n,), the tracks that live, (n, 2) their ``places``, metres, (n,) whether they are ``coasting``.
            places: see there.
            coasting: see there.
        """
        self.tracks[t - self.lost_at > self.kept] = 0
        alive = self.alive
        ended = alive[~np.isin(self.tracks[alive], ids)]
        self.lost_at[ended] = t
        fresh = np.flatnonzero(~np.isin(ids, self.tracks))
        if len(fresh):
            free = np.flatnonzero(self.tracks == 0)
            if len(free) < len(fresh):
                self._grow(BLOCK * math.ceil((len(fresh) - len(free)) / BLOCK))
                free = np.flatnonzero(self.tracks == 0)
            began = free[: len(fresh)]
            self.tracks[began], self.lost_at[began] = ids[fresh], math.inf
            for column in began.tolist():
                self.history.forget(column)
        else:
            began = np.zeros(0, np.int64)
        back = np.isin(self.tracks, ids) & (self.lost_at < math.inf)
        if back.any():
            # Told again after a while: the same track, whose hypotheses begin anew.
            began = np.append(began, np.flatnonzero(back))
            self.lost_at[back] = math.inf
        columns = self.of(ids)
        self.place[columns], self.coasting[columns] = places, coasting
        self.history.append(t, columns, places, len(self.tracks))
        return ended, began

    def _grow(self, more: int) -> None:
        self.tracks = np.concatenate([self.tracks, np.zeros(more, np.int64)])
        self.lost_at = np.concatenate([self.lost_at, np.full(more, math.inf)])
        self.place = np.concatenate([self.place, np.zeros((more, 2))])
        self.coasting = np.concatenate([self.coasting, np.zeros(more, np.bool_)])

    def state(self) -> dict[str, Any]:
        """Return copies of all."""
        return {**{name: getattr(self, name).copy() for name in _ARRAYS}, "history": self.history.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state()``."""
        for name in _ARRAYS:
            setattr(self, name, unpack(state[name]))
        self.history.restore(state["history"])


_ARRAYS = ("tracks", "lost_at", "place", "coasting")
