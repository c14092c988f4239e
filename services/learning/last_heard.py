"""When was each phone heard last of which something is kept? Who stays away is let go, and so are more than fit.

Hours are told apart, no more: that is all it takes, and what is saved then changes once an hour.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import msgspec

from services.learning.activation.states import KEPT

__all__ = ["HOUR", "MOST", "LastHeard"]

HOUR = 3600.0
MOST = 4000
"""Phones with models; with a stride and a heading each there is a publisher left for every one of them."""


class LastHeard:
    """Of one site's phones."""

    def __init__(self) -> None:
        self._hours: dict[str, float] = {}
        self._lately: set[str] = set()

    def hear(self, device: str) -> None:
        """Note that a phone said something."""
        self._lately.add(device)

    def forget(self, device: str) -> None:
        """Forget a phone."""
        self._hours.pop(device, None)
        self._lately.discard(device)

    def look(self, known: Collection[str], now: float) -> list[str]:
        """Return whom to let go of the phones of which something is kept; to be asked once an hour.

        Args:
            known: the phones. Of one that is new here the time begins now.
            now: wall clock, seconds since the epoch; where it was set back, times in the future become now.
        """
        hour = now // HOUR * HOUR
        self._hours = {
            device: hour if device in self._lately else min(self._hours.get(device, hour), hour) for device in known
        }
        self._lately.clear()
        oldest = sorted(self._hours, key=lambda device: (self._hours[device], device))
        return [
            device
            for place, device in enumerate(oldest)
            if place < len(oldest) - MOST or self._hours[device] < now - KEPT
        ]

    def state(self) -> dict[str, float]:
        """Return by phone the hour in which it was heard last, seconds since the epoch."""
        return dict(self._hours)

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            ValueError: it is none.
        """
        self._hours = msgspec.convert(state, dict[str, float])
