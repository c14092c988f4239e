"""Phones that post as fast as they are answered, or by the clock, over plain sockets: a process of its own.

Bodies are made beforehand but for their stamps. One JSON object in on standard input, one out on standard output.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import asdict, dataclass

import uvloop

from benchmarks.http_askers import Answers, Askers
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
class Outcome(Answers):
    """What became of it: batches, and where the next load begins.

    Attributes:
        next_seq: of the next load.
    """

    next_seq: int

    def unanswered(self) -> int:
        """Return how many batches wanted were never answered."""
        return self.wanted - sum(self.status.values())


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


class _Phones:
    """Makes the requests: phones take turns, each walks on by a second."""

    def __init__(self, load: Load) -> None:
        self._load = load
        self._bodies = bodies()
        self._heads = [
            f"POST {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {token}\r\n"
            f"Content-Type: application/json\r\nContent-Length: {{}}\r\n\r\n"
            for path, token in load.phones
        ]
        self._sent = 0

    @property
    def next_seq(self) -> int:
        """Of the next load."""
        return self._load.first_seq + -(-self._sent // len(self._heads))

    def request(self) -> bytes:
        """Return the next request."""
        turn, phone = divmod(self._sent, len(self._heads))
        self._sent += 1
        seq = self._load.first_seq + turn
        template = self._bodies[(phone * 60 + seq) % len(self._bodies)]
        second = b"%d" % (self._load.epoch + seq)
        body = template.replace(STAMP, b"%.6f" % time.time()).replace(SECOND, second).replace(SEQ, b"%d" % seq)
        return self._heads[phone].format(len(body)).encode() + body


def drive() -> int:
    """Read a load, send it, write what became of it."""
    load = Load(**json.load(sys.stdin))
    phones = _Phones(load)
    askers = Askers(load.port, phones.request, load.seconds, load.connections, load.per_second)
    outcome = Outcome(**asdict(uvloop.run(askers.run())), next_seq=phones.next_seq)
    json.dump(asdict(outcome), sys.stdout)
    return 0


if __name__ == "__main__":
    sys.exit(drive())
