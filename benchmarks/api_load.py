"""Clients of the API over plain sockets, in a process of their own: ones that ask, and ones that listen.

The same generator for every server. One JSON object in on standard input, one out on standard output.
"""

from __future__ import annotations

import asyncio
import json
import re
import sys
import time
from collections import Counter, deque
from dataclasses import asdict, dataclass
from typing import Literal, cast

import uvloop

from benchmarks.gateway_load import percentiles_ms

__all__ = ["Load", "Outcome", "drive"]

_STAMP = re.compile(rb'"t":([0-9.]+)')
EARLY = 0.005
"""Seconds by which the loop's clock may wake us too soon: until then clients ask once more."""
PATIENCE = 10.0
"""Seconds for answers that are late, and for streams to open."""


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


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of it.

    Attributes:
        wanted: requests that were sent or due; of streams, events that the busiest client got, times the clients.
        status: answers by status; of streams, one for each.
        per_second: answers with 200, or events, a second.
        p50_ms: from when a request was due to its answer, from the time an event tells to its arrival; what never came
            took for ever.
        p99_ms: likewise.
    """

    wanted: int
    status: dict[str, int]
    per_second: float
    p50_ms: float
    p99_ms: float


class _Asker(asyncio.Protocol):
    """One connection: a request, its answer, the next."""

    def __init__(self, crowd: _Askers) -> None:
        self._crowd = crowd
        self._due = 0.0
        self._received = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the connection."""
        self._transport = cast(asyncio.Transport, transport)

    def send(self, due: float) -> None:
        """Send the request, which was due at a time of ``perf_counter``."""
        self._due = due
        self._transport.write(self._crowd.request)

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


class _Askers:
    def __init__(self, load: Load) -> None:
        self._load = load
        self.request = load.request
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
        if self._load.per_second:
            if self._due:
                self._send(client, self._due.popleft())
            else:
                self._idle.append(client)
        elif now < self._end:
            self._send(client, now)

    async def run(self) -> Outcome:
        """Ask, and wait for the answers."""
        loop, load = asyncio.get_running_loop(), self._load
        clients = [
            (await loop.create_connection(lambda: _Asker(self), "127.0.0.1", load.port))[1]
            for _ in range(load.connections)
        ]
        begin = time.perf_counter()
        self._end = begin + load.seconds
        if load.per_second:
            self._idle.extend(clients)
            for k in range(int(load.per_second * load.seconds)):
                due = begin + k / load.per_second
                if due > time.perf_counter():
                    await asyncio.sleep(due - time.perf_counter())
                if self._idle:
                    self._send(self._idle.popleft(), due)
                else:
                    self._due.append(due)
        else:
            for client in clients:
                self._send(client, time.perf_counter())
            await asyncio.sleep(load.seconds + EARLY)
        wanted = self._sent + len(self._due)
        deadline = time.perf_counter() + PATIENCE
        while len(self._times) < wanted and time.perf_counter() < deadline:
            await asyncio.sleep(0.01)
        p50, p99 = percentiles_ms(self._times, wanted)
        taken = max(load.seconds, time.perf_counter() - begin) if load.per_second else load.seconds
        return Outcome(wanted, dict(self._status), self._status["200"] / taken, p50, p99)

    def _send(self, client: _Asker, due: float) -> None:
        self._sent += 1
        client.send(due)


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


async def _listen(load: Load) -> Outcome:
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
    return Outcome(wanted, status, sum(map(len, delays)) / load.seconds, p50, p99)


def drive() -> int:
    """Read a load, do it, write what became of it."""
    load = Load(**json.load(sys.stdin))
    outcome = uvloop.run(_Askers(load).run() if load.what == "ask" else _listen(load))
    json.dump(asdict(outcome), sys.stdout)
    return 0


if __name__ == "__main__":
    sys.exit(drive())
