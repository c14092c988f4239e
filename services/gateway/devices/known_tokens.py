"""Whose token is this, as far as lately looked up? Spares a batch its query, and the database the last word."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable

from services.gateway.devices.storage import Registered

__all__ = ["KnownTokens"]


class KnownTokens:
    """Devices by token, as the database told; touched by one thread only.

    Args:
        seconds: how long an answer counts; a device withdrawn elsewhere is served no longer than this.
        most: tokens remembered; the one longest unused is forgotten first.
        clock: seconds that never run backwards.
    """

    def __init__(self, seconds: float, most: int = 10_000, clock: Callable[[], float] = time.monotonic) -> None:
        self._seconds = seconds
        self._most = most
        self._clock = clock
        self._known: OrderedDict[str, tuple[Registered, float]] = OrderedDict()

    def __len__(self) -> int:
        """How many tokens are remembered."""
        return len(self._known)

    def get(self, token: str) -> Registered | None:
        """Return the device, None where the database is to be asked (again)."""
        found = self._known.get(token)
        if found is None:
            return None
        device, until = found
        if self._clock() >= until:
            del self._known[token]
            return None
        self._known.move_to_end(token)
        return device

    def remember(self, token: str, device: Registered) -> None:
        """Keep what the database said just now."""
        self._known[token] = (device, self._clock() + self._seconds)
        self._known.move_to_end(token)
        if len(self._known) > self._most:
            self._known.popitem(last=False)

    def forget(self, token: str) -> None:
        """Forget one token."""
        self._known.pop(token, None)
