"""Is an access point heard where it should be? The scans of the last minutes that heard it, and that missed it."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from services.learning.tracks.stretch import Stretch

__all__ = ["RecentHearing"]

Array = NDArray[np.float64]

LOUD = -80.0
"""dBm from which every phone should hear an access point."""
MEMORY = 600.0
"""Seconds for which scans are remembered."""
MISSED = 40
"""Scans that must have missed it, by two phones where there are two."""
MOST = 2000
"""Stretches that are remembered."""


class RecentHearing:
    """Counts of m access points."""

    def __init__(self, points: int) -> None:
        self._points = points
        self._told: deque[tuple[float, str, Array, Array]] = deque(maxlen=MOST)
        self._heard = np.full(points, -np.inf)

    def take(self, stretch: Stretch, expected: Array) -> None:
        """Take in a stretch and the levels (r, m) expected at the places of its readings, dBm."""
        times, first, scan = np.unique(stretch.scan_t, return_index=True, return_inverse=True)
        heard = np.zeros((len(times), self._points), np.bool_)
        heard[scan.ravel(), stretch.point] = True
        missed = ~heard & (expected[first] > LOUD)
        last = np.where(heard, times[:, None], -np.inf).max(axis=0, initial=-np.inf)
        self._heard = np.maximum(self._heard, last)
        self._told.append((float(times[-1]), stretch.device, heard.sum(axis=0), missed.sum(axis=0)))

    def forget(self, device: str) -> None:
        """Forget a device."""
        self._told = deque((row for row in self._told if row[1] != device), MOST)

    def silent(self, point: int, now: float) -> float | None:
        """Return since when an access point is silent, seconds since the epoch; None where it is not."""
        while self._told and self._told[0][0] < now - MEMORY:
            self._told.popleft()
        since = float(self._heard[point])
        rows = [row for row in self._told if row[0] > since]
        missed = {device: 0 for _, device, _, _ in self._told}
        for _, device, _, count in rows:
            missed[device] += int(count[point])
        phones = sum(count > 0 for count in missed.values())
        if sum(missed.values()) < MISSED or phones < min(2, len(missed)):
            return None
        return since if np.isfinite(since) else min(row[0] for row in rows)
