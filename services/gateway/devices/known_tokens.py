"""Whose token is this, as far as lately looked up? Spares a batch its query, and the database the last word."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

from services.gateway.devices.storage import Registered
from services.gateway.devices.tokens import Claims

__all__ = ["Grant", "KnownTokens"]


@dataclass(frozen=True, slots=True)
class Grant:
    """A valid token: what it says, and the device it belongs to."""

    claims: Claims
    device: Registered


class KnownTokens:
    """Grants by token, as the database told; touched by one thread only.

    Args:
        seconds: how long an answer counts; a token revoked elsewhere is served no longer than this.
        most: tokens remembered; the one longest unused is forgotten first.
        clock: seconds that never run backwards.
    """

    def __init__(self, seconds: float, most: int = 10_000, clock: Callable[[], float] = time.monotonic) -> None:
        self._seconds = seconds
        self._most = most
        self._clock = clock
        self._known: OrderedDict[str, tuple[Grant, float]] = OrderedDict()
        self.changes = 0
        """How often something was forgotten: an answer of the database from before a change may be outdated."""

    def __len__(self) -> int:
        """How many tokens are remembered."""
        return len(self._known)

    def get(self, token: str) -> Grant | None:
        """Return whose it is, None where the database is to be asked (again)."""
        found = self._known.get(token)
        if found is None:
            return None
        grant, until = found
        if self._clock() >= until:
            del self._known[token]
            return None
        self._known.move_to_end(token)
        return grant

    def remember(self, token: str, grant: Grant, now: float) -> None:
        """Keep what the database said just now (server clock ``now``), no longer than the token is valid."""
        self._known[token] = (grant, self._clock() + min(self._seconds, grant.claims.expires - now))
        self._known.move_to_end(token)
        if len(self._known) > self._most:
            self._known.popitem(last=False)

    def forget(self, device: str, token_id: str | None = None) -> None:
        """Forget one token of a device, or all of them."""
        self.changes += 1
        for token, (grant, _) in list(self._known.items()):
            if grant.claims.device == device and token_id in (None, grant.claims.id):
                del self._known[token]
