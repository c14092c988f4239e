"""What one browser has still to be sent: the newest of each kind, so that a slow browser never falls behind."""

from __future__ import annotations

import asyncio

__all__ = ["Mailbox"]


class Mailbox:
    """A bounded queue by topic: a newer post on a topic replaces the one that still waits.

    Positions are worth nothing once newer ones exist; alerts have a topic each and are all delivered.
    Belongs to one event loop.
    """

    def __init__(self, capacity: int = 500) -> None:
        self._capacity = capacity
        self._waiting: dict[str, bytes] = {}
        self._wake = asyncio.Event()
        self.closed = False
        self.dropped = 0

    def post(self, topic: str, chunk: bytes) -> None:
        """Leave ``chunk`` for the browser; beyond the capacity the topic waiting longest is given up and counted."""
        self._waiting[topic] = chunk
        if len(self._waiting) > self._capacity:
            del self._waiting[next(iter(self._waiting))]
            self.dropped += 1
        self._wake.set()

    async def take(self, timeout: float) -> bytes:
        """Wait up to ``timeout`` seconds and return all that waits, oldest topic first; empty if nothing came."""
        try:
            await asyncio.wait_for(self._wake.wait(), timeout)
        except TimeoutError:
            return b""
        self._wake.clear()
        chunk = b"".join(self._waiting.values())
        self._waiting.clear()
        return chunk

    def close(self) -> None:
        """Tell the reader that nothing more comes."""
        self.closed = True
        self._wake.set()
