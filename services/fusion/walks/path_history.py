"""Where was each track when the phone listened? The last seconds of all tracks' positions, by column."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.fusion.snapshot import unpack

__all__ = ["PathHistory"]

Array = NDArray[np.float64]

LENGTH = 96
"""Rows kept: 6.4 s of chunks of 1/15 s, more than the 5 s by which a scan may be late."""


class PathHistory:
    """A ring of times and positions; one column per track, NaN where a track was not."""

    def __init__(self) -> None:
        self._reset()

    def _reset(self) -> None:
        self._times = np.full(LENGTH, -math.inf)
        self._places = np.full((LENGTH, 0, 2), np.nan)
        self._next = 0

    @property
    def newest(self) -> float:
        """Time of the newest positions; minus infinity before any."""
        return float(self._times[self._next - 1])

    def append(self, t: float, columns: NDArray[np.int64], places: Array, width: int) -> None:
        """Store positions (n, 2) of the tracks in ``columns`` at time ``t``; ``width`` is the number of columns."""
        if t < self.newest:
            self._reset()
        if width > self._places.shape[1]:
            wider = np.full((LENGTH, width, 2), np.nan)
            wider[:, : self._places.shape[1]] = self._places
            self._places = wider
        self._times[self._next] = t
        self._places[self._next] = np.nan
        self._places[self._next, columns] = places
        self._next = (self._next + 1) % LENGTH

    def forget(self, column: int) -> None:
        """Empty a column for another track."""
        if column < self._places.shape[1]:
            self._places[:, column] = np.nan

    def at(self, t: float) -> Array:
        """Return the positions (k, 2) at time ``t``, interpolated; NaN where unknown."""
        before = int(np.argmax(np.where(self._times <= t, self._times, -math.inf)))
        after = int(np.argmin(np.where(self._times >= t, self._times, math.inf)))
        start, end = self._times[before], self._times[after]
        if not start <= t <= end or math.isinf(start):
            return np.full(self._places.shape[1:], np.nan)
        share = 0.0 if end == start else (t - start) / (end - start)
        found: Array = (1.0 - share) * self._places[before] + share * self._places[after]
        return found

    def state(self) -> dict[str, Any]:
        """Return a copy of the ring."""
        return {"times": self._times.copy(), "places": self._places.copy(), "next": self._next}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state()``."""
        self._times, self._places, self._next = unpack(state["times"]), unpack(state["places"]), int(state["next"])
