"""Sums of days that are over, kept for a while: whoever looks at a month looks at it more than once."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

__all__ = ["DaySums"]

KEPT = 3600.0
"""Seconds: what comes in late, thinned or imported shows after that."""
SETTLED = 900.0
"""Seconds after which a day that is over has most likely been written down."""
MOST_BYTES = 64 * 2**20

T = TypeVar("T")


class DaySums:
    """May be used from any thread.

    Args:
        clock: returns seconds since the epoch.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._sums: OrderedDict[Hashable, tuple[float, int, Any]] = OrderedDict()
        self._bytes = 0

    def get(self, key: Hashable, until: float, size: Callable[[T], int], make: Callable[[], T]) -> T:
        """Return the sum of a day, made now unless it was lately.

        Args:
            key: of which day, and of what.
            until: when the day ends; one that is not over is not kept.
            size: bytes of a sum.
            make: sums up.
        """
        now = self._clock()
        with self._lock:
            made, _, kept = self._sums.get(key, (-KEPT, 0, None))
        if 0.0 <= now - made < KEPT:
            found: T = kept
            return found
        fresh = make()
        if until + SETTLED < now:
            with self._lock:
                self._bytes -= self._sums.pop(key, (0.0, 0, None))[1]
                self._sums[key] = now, size(fresh), fresh
                self._bytes += size(fresh)
                while self._bytes > MOST_BYTES:
                    self._bytes -= self._sums.popitem(last=False)[1][1]
        return fresh
