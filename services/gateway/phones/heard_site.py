"""Do phones hear the site's access points at all? If hardly any does, the site file is wrong, and nobody is located."""

from __future__ import annotations

import threading
from collections import deque

__all__ = ["HeardSite"]

WINDOW = 60.0
"""Seconds looked back."""
LEAST = 20
"""Scans within them from which it is told …"""
SHARE = 0.8
"""… where so many of them held no known address."""


class HeardSite:
    """Counts scans of the last minute; notes and reads may come from different threads."""

    def __init__(self) -> None:
        self._batches: deque[tuple[float, int, bool]] = deque()
        self._lock = threading.Lock()

    def note(self, scans: int, readings: int, unknown: int, now: float) -> None:
        """Note a batch.

        Args:
            scans: how many it held.
            readings: of them, of known access points.
            unknown: addresses the site file does not know.
            now: monotonic, s.
        """
        with self._lock:
            if scans and (readings or unknown):
                self._batches.append((now, scans, readings == 0))
            self._drop(now)

    def problem(self, now: float) -> str | None:
        """Return in plain words what is wrong with what phones heard in the minute before ``now``; None if nothing."""
        with self._lock:
            self._drop(now)
            scans = sum(count for _, count, _ in self._batches)
            deaf = sum(count for _, count, strange in self._batches if strange)
        if scans < LEAST or deaf < SHARE * scans:
            return None
        return (
            "nearly all scans of the last minute held unknown access points only: whoever sent them is not located by "
            "radio; are the addresses in the site file those that phones hear, and are the phones here?"
        )

    def _drop(self, now: float) -> None:
        while self._batches and self._batches[0][0] < now - WINDOW:
            self._batches.popleft()
