"""How soon again? Rations by name whatever costs something: attempts to enrol, batches."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable

__all__ = ["RateLimiter"]


class RateLimiter:
    """A token bucket for each name: a client's address, a device.

    Args:
        per_second: in the long run.
        burst: at once.
        clock: seconds that never run backwards.
        names: how many are remembered; the one longest unseen is forgotten first.
    """

    def __init__(
        self, per_second: float, burst: int, clock: Callable[[], float] = time.monotonic, names: int = 10_000
    ) -> None:
        self._rate = per_second
        self._burst = float(burst)
        self._clock = clock
        self._names = names
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()
        self._lock = threading.Lock()

    def wait(self, name: str, cost: float = 1.0) -> float:
        """Return 0 where this name may go on now, else the seconds until it may."""
        with self._lock:
            missing = cost - self._level(name)
        return max(0.0, missing / self._rate)

    def spend(self, name: str, cost: float = 1.0) -> None:
        """Count one; the level may fall below zero."""
        with self._lock:
            self._buckets[name] = (self._level(name) - cost, self._clock())
            self._buckets.move_to_end(name)
            if len(self._buckets) > self._names:
                self._buckets.popitem(last=False)

    def _level(self, name: str) -> float:
        level, since = self._buckets.get(name, (self._burst, self._clock()))
        return min(self._burst, level + (self._clock() - since) * self._rate)
