"""Phones that post as fast as they are answered, or by the clock, over plain sockets: a process of its own.

The same generator for every server: bodies are made beforehand but for their stamps, connections are kept, an answer is
read no further than its status. One JSON object in on standard input, one out on standard output.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import cast

import numpy as np
import uvloop

from benchmarks.mall_traces import read_trace
from benchmarks.reckoning_speed import walking
from shared.settings import data_folder

__all__ = ["Load", "Outcome", "bodies", "drive"]

RATE = 50
WALKS = 8
HEARD = 12
"""Access points in a scan; the site knows some of them."""
STAMP, SECOND, SEQ = b"1111111111.111111", b"2222222222", b"33333333"


@dataclass(frozen=True, slots=True)
class Load:
    """What to send.

    Attributes:
        port: of the server, on this machine.
        phones: (path, token) of each.
        first_seq: of each phone's first batch.
        epoch: when the walk began, s; batch ``seq`` is its second ``seq``.
        seconds: how long.
        connections: kept open.
        per_second: batches by the clock; 0: each connection sends again as soon as it is answered.
    """

    port: int
    phones: list[tuple[str, str]]
    first_seq: int
    epoch: int
    seconds: float
    connections: int
    per_second: float = 0.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of it.

    Attributes:
        wanted: batches that were sent or were due.
        status: answers by status.
        per_second: answers with 2xx a second.
        p50_ms: of the times of all batches wanted, from when they were due; one that was never answered took for ever.
        p99_ms: likewise.
        next_seq: of the next load.
    """

    wanted: int
    status: dict[str, int]
    per_second: float
    p50_ms: float
    p99_ms: float
    next_seq: int

    def unanswered(self) -> int:
        """Return how many batches wanted were never answered."""
        return self.wanted - sum(self.status.values())


def percentiles_ms(times: Sequence[float], wanted: int) -> tuple[float, float]:
    """Return median and 99th percentile, ms, of ``wanted`` times, s; those that are not there are infinite."""
    every = np.concatenate([times, np.full(wanted - len(times), np.inf)])
    p50, p99 = np.percentile(every, [50, 99], method="higher") * 1000.0
    return float(p50), float(p99)


def bodies() -> list[bytes]:
    """Return real walks second by second, 50 samples with nine channels and a scan, as JSON with places for stamps."""
    made = []
    folder = data_folder() / "indoor-location" / "site1" / "F1" / "path_data_files"
    for path in sorted(folder.glob("*.txt.gz"))[:WALKS]:
        recording = walking(read_trace(path), RATE)
        for k in range(min(len(recording) // RATE, 60)):
            part = recording[k * RATE : (k + 1) * RATE]
            columns = {
                name: [round(value, 4) for value in column]
                for name, column in zip(("ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz"), part.T[1:], strict=True)
            }
            scan = {
                "t": "SCAN",
                "address": [f"02:a7:00:00:00:{n:02x}" for n in range(1, HEARD + 1)],
                "rssi": [-50.0 - n for n in range(HEARD)],
            }
            text = json.dumps({"sent": "SENT", "seq": "SEQ", "imu": {"t": "T", **columns}, "radio": [scan]})
            stamps = ", ".join(f"{SECOND.decode()}.{i * 2:02d}" for i in range(RATE))
            for name, value in (("SENT", STAMP.decode()), ("SEQ", SEQ.decode()), ("SCAN", f"{SECOND.decode()}.5")):
                text = text.replace(f'"{name}"', value)
            made.append(text.replace('"T"', f"[{stamps}]").encode())
    return made


class _Client(asyncio.Protocol):
    """One connection: a request, its answer, the next."""

    def __init__(self, load: _Generator) -> None:
        self._load = load
        self._due = 0.0
        self._received = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the connection."""
        self._transport = cast(asyncio.Transport, transport)

    def send(self, due: float) -> None:
        """Send the next request, which was due at a time of ``perf_counter``."""
        self._due = due
        self._transport.write(self._load.request())

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
        self._load.answered(self, status, self._due)


class _Generator:
    def __init__(self, load: Load) -> None:
        self._load = load
        self._bodies = bodies()
        self._heads = [
            f"POST {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {token}\r\n"
            f"Content-Type: application/json\r\nContent-Length: {{}}\r\n\r\n"
            for path, token in load.phones
        ]
        self._sent = 0
        self._idle: deque[_Client] = deque()
        self._due: deque[float] = deque()
        self._times: list[float] = []
        self._status: Counter[str] = Counter()
        self._end = 0.0

    def request(self) -> bytes:
        """Return the next request: phones take turns, each walks on by a second."""
        turn, phone = divmod(self._sent, len(self._heads))
        self._sent += 1
        seq = self._load.first_seq + turn
        template = self._bodies[(phone * 60 + seq) % len(self._bodies)]
        second = b"%d" % (self._load.epoch + seq)
        body = template.replace(STAMP, b"%.6f" % time.time()).replace(SECOND, second).replace(SEQ, b"%d" % seq)
        return self._heads[phone].format(len(body)).encode() + body

    def answered(self, client: _Client, status: str, due: float) -> None:
        """Note an answer and let the connection go on."""
        now = time.perf_counter()
        self._status[status] += 1
        self._times.append(now - due)
        if self._load.per_second:
            if self._due:
                client.send(self._due.popleft())
            else:
                self._idle.append(client)
        elif now < self._end:
            client.send(now)

    async def run(self) -> Outcome:
        """Send it all and wait for the answers."""
        loop = asyncio.get_running_loop()
        load = self._load
        clients = []
        for _ in range(load.connections):
            _, client = await loop.create_connection(lambda: _Client(self), "127.0.0.1", load.port)
            clients.append(client)
        begin = time.perf_counter()
        self._end = begin + load.seconds
        if load.per_second:
            self._idle.extend(clients)
            for k in range(int(load.per_second * load.seconds)):
                due = begin + k / load.per_second
                if due > time.perf_counter():
                    await asyncio.sleep(due - time.perf_counter())
                if self._idle:
                    self._idle.popleft().send(due)
                else:
                    self._due.append(due)
        else:
            for client in clients:
                client.send(time.perf_counter())
            await asyncio.sleep(load.seconds)
        wanted = self._sent + len(self._due)
        deadline = time.perf_counter() + 10.0
        while len(self._times) < wanted and time.perf_counter() < deadline:
            await asyncio.sleep(0.01)
        taken = sum(count for status, count in self._status.items() if status.startswith("2"))
        p50, p99 = percentiles_ms(self._times, wanted)
        last = begin + load.seconds
        per_second = taken / (max(last, time.perf_counter()) - begin) if load.per_second else taken / load.seconds
        next_seq = load.first_seq + -(-self._sent // len(self._heads))
        return Outcome(wanted, dict(self._status), per_second, p50, p99, next_seq)


def drive() -> int:
    """Read a load, send it, write what became of it."""
    load = Load(**json.load(sys.stdin))
    outcome = uvloop.run(_Generator(load).run())
    json.dump(asdict(outcome), sys.stdout)
    return 0


if __name__ == "__main__":
    sys.exit(drive())
