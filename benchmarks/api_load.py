"""Clients of the API over plain sockets, in a process of their own: ones that ask, and ones that listen.

One JSON object in on standard input, one out on standard output.
"""

from __future__ import annotations

import asyncio
import json
import re
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass
from typing import Literal, cast

import uvloop

from benchmarks.http_askers import PATIENCE, Answers, Askers, percentiles_ms

__all__ = ["Load", "drive"]

_STAMP = re.compile(rb'"t":([0-9.]+)')


@dataclass(frozen=True, slots=True)
class Load:
    """What to do.

    Attributes:
        what: ``ask`` again and again, or ``listen`` to a stream.
        port: of the server, on this machine.
        path: asked for.
        key: of the API.
        seconds: how long; of streams, once all are open.
        connections: kept open.
        per_second: requests by the clock; 0: each connection asks again as soon as it is answered.
    """

    what: Literal["ask", "listen"]
    port: int
    path: str
    key: str
    seconds: float
    connections: int
    per_second: float = 0.0

    @property
    def request(self) -> bytes:
        """The bytes of the one request."""
        return f"GET {self.path} HTTP/1.1\r\nHost: 127.0.0.1\r\nX-API-Key: {self.key}\r\n\r\n".encode()


class _Listener(asyncio.Protocol):
    """One stream: when each event was made and when it was here."""

    def __init__(self, request: bytes) -> None:
        self._request = request
        self._rest = b""
        self.status = ""
        self.heard: list[tuple[float, float]] = []
        """The time an event tells, and that of its arrival; wall clock."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Ask for the stream."""
        cast(asyncio.Transport, transport).write(self._request)

    def data_received(self, data: bytes) -> None:
        """Take in what is whole."""
        now = time.time()
        if not self.status:
            self.status = data[9:12].decode()
        *events, self._rest = (self._rest + data).split(b"\n\n")
        for event in events:
            found = _STAMP.search(event)
            if found is not None:
                self.heard.append((float(found[1]), now))


async def _listen(load: Load) -> Answers:
    """Return of the events what is said of requests; wanted: what the busiest client got, times the clients."""
    loop = asyncio.get_running_loop()
    listeners = [
        (await loop.create_connection(lambda: _Listener(load.request), "127.0.0.1", load.port))[1]
        for _ in range(load.connections)
    ]
    deadline = time.monotonic() + PATIENCE
    while not all(each.status for each in listeners) and time.monotonic() < deadline:
        await asyncio.sleep(0.01)
    begin = time.time()
    await asyncio.sleep(load.seconds)
    end = time.time()
    await asyncio.sleep(1.0)
    # Those that were made while all listened: whoever lacks one has waited for it for ever.
    delays = [[now - made for made, now in each.heard if begin <= made < end] for each in listeners]
    wanted = max(map(len, delays)) * len(listeners)
    p50, p99 = percentiles_ms([delay for each in delays for delay in each], wanted)
    status = dict(Counter(each.status or "none" for each in listeners))
    return Answers(wanted, status, sum(map(len, delays)) / load.seconds, p50, p99)


def drive() -> int:
    """Read a load, do it, write what became of it."""
    load = Load(**json.load(sys.stdin))
    request = load.request
    askers = Askers(load.port, lambda: request, load.seconds, load.connections, load.per_second)
    outcome = uvloop.run(askers.run() if load.what == "ask" else _listen(load))
    json.dump(asdict(outcome), sys.stdout)
    return 0


if __name__ == "__main__":
    sys.exit(drive())
