"""Clients that ask a server over plain sockets as fast as they are answered, or by the clock; the same for every one.

Connections are kept, an answer is read no further than its status.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

__all__ = ["PATIENCE", "Answers", "Askers", "percentiles_ms"]

EARLY = 0.005
"""Seconds by which the loop's clock may wake us too soon: until then clients ask once more."""
PATIENCE = 10.0
"""Seconds for answers that are late, and for streams to open."""


def percentiles_ms(times: Sequence[float], wanted: int) -> tuple[float, float]:
    """Return median and 99th percentile, ms, of ``wanted`` times, s; those that are not there are infinite."""
    every = np.concatenate([times, np.full(wanted - len(times), np.inf)])
    p50, p99 = np.percentile(every, [50, 99], method="higher") * 1000.0
    return float(p50), float(p99)


@dataclass(frozen=True, slots=True)
class Answers:
    """What became of the requests.

    Attributes:
        wanted: requests that were sent or due.
        status: answers by status.
        per_second: answers with 2xx a second.
        p50_ms: from when a request was due to its answer; what never came took for ever.
        p99_ms: likewise.
    """

    wanted: int
    status: dict[str, int]
    per_second: float
    p50_ms: float
    p99_ms: float


class _Asker(asyncio.Protocol):
    """One connection: a request, its answer, the next."""

    def __init__(self, crowd: Askers) -> None:
        self._crowd = crowd
        self._due = 0.0
        self._received = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the connection."""
        self._transport = cast(asyncio.Transport, transport)

    def send(self, request: bytes, due: float) -> None:
        """Send a request, which was due at a time of ``perf_counter``."""
        self._due = due
        self._transport.write(request)

    def data_received(self, data: bytes) -> None:
        """Collect an answer."""
        self._received += data
        head = self._received.find(b"\r\n\r\n")
        if head < 0:
            return
        at = self._received.lower().find(b"content-length:", 0, head)
        length = int(self._received[at + 15 : self._received.index(b"\r\n", at)])
        if len(self._received) < head + 4 + length:
            return
        status, self._received = self._received[9:12].decode(), b""
        self._crowd.answered(self, status, self._due)


class Askers:
    """Ask for a while.

    Args:
        port: of the server, on this machine.
        request: makes the next request.
        seconds: how long.
        connections: kept open.
        per_second: requests by the clock; 0: each connection asks again as soon as it is answered.
    """

    def __init__(
        self, port: int, request: Callable[[], bytes], seconds: float, connections: int, per_second: float
    ) -> None:
        self._port, self._request = port, request
        self._seconds, self._connections, self._per_second = seconds, connections, per_second
        self._idle: deque[_Asker] = deque()
        self._due: deque[float] = deque()
        self._times: list[float] = []
        self._status: Counter[str] = Counter()
        self._sent = 0
        self._end = 0.0

    def answered(self, client: _Asker, status: str, due: float) -> None:
        """Note an answer and let the connection go on."""
        now = time.perf_counter()
        self._status[status] += 1
        self._times.append(now - due)
        if self._per_second:
            if self._due:
                self._send(client, self._due.popleft())
            else:
                self._idle.append(client)
        elif now < self._end:
            self._send(client, now)

    async def run(self) -> Answers:
        """Ask, and wait for the answers."""
        loop, seconds = asyncio.get_running_loop(), self._seconds
        clients = [
            (await loop.create_connection(lambda: _Asker(self), "127.0.0.1", self._port))[1]
            for _ in range(self._connections)
        ]
        begin = time.perf_counter()
        self._end = begin + seconds
        if self._per_second:
            self._idle.extend(clients)
            for k in range(int(self._per_second * seconds)):
                due = begin + k / self._per_second
                if due > time.perf_counter():
                    await asyncio.sleep(due - time.perf_counter())
                if self._idle:
                    self._send(self._idle.popleft(), due)
                else:
                    self._due.append(due)
        else:
            for client in clients:
                self._send(client, time.perf_counter())
            await asyncio.sleep(seconds + EARLY)
        wanted = self._sent + len(self._due)
        deadline = time.perf_counter() + PATIENCE
        while len(self._times) < wanted and time.perf_counter() < deadline:
            await asyncio.sleep(0.01)
        p50, p99 = percentiles_ms(self._times, wanted)
        taken = max(seconds, time.perf_counter() - begin) if self._per_second else seconds
        good = sum(count for status, count in self._status.items() if status.startswith("2"))
        return Answers(wanted, dict(self._status), good / taken, p50, p99)

    def _send(self, client: _Asker, due: float) -> None:
        self._sent += 1
        client.send(self._request(), due)
