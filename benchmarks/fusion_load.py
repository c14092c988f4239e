"""A load for fusion: what the sensors of a world said, sent on the bus by the clock, or as fast as fusion keeps up.

Runs as a process of its own: ``python -m benchmarks.fusion_load LOAD SENT`` reads a ``LoadFile`` and writes a ``Sent``.
Everything the clock paces is encoded before the first message is sent.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, cast

import msgspec
from msgspec.structs import replace

from shared.bus import Bus, Publisher
from shared.keys import Keys
from shared.messages import ChunkMark, DetectionFrame, MotionBatch, RadioScan, encode

__all__ = ["LoadFile", "Said", "Sent", "drive", "looped", "thinned"]

Phone = RadioScan | MotionBatch
Said = DetectionFrame | RadioScan | MotionBatch

READY_WITHIN = 30.0
BEHIND = 4
"""Frames of a camera by which fusion may be behind a load without a clock: fewer than wait in its inbox at most."""
PATIENCE = 30.0


class LoadFile(msgspec.Struct, frozen=True):
    """What to send.

    Attributes:
        endpoint: of the router; ``site`` and ``area``: whose keys.
        offset: (n,) seconds from the beginning at which each message is due.
        frames, scans, motions: the messages by kind, in the order in which ``kind`` names them.
        kind: (n,) ``f``, ``s`` or ``m``.
        rounds: how often all of it is told, shifted in time by ``period`` seconds each.
        clock: whether messages are sent when due; otherwise as fast as fusion consumes them.
    """

    endpoint: str
    site: str
    area: str
    offset: list[float]
    frames: list[DetectionFrame]
    scans: list[RadioScan]
    motions: list[MotionBatch]
    kind: str
    period: float
    rounds: int = 1
    clock: bool = True

    @classmethod
    def of(cls, endpoint: str, site: str, area: str, arrivals: Sequence[tuple[float, Said]], **more: Any) -> LoadFile:
        """Return the load that tells ``arrivals``, (time, message) in order of time."""
        first = arrivals[0][0]
        said = [message for _, message in arrivals]
        return cls(
            endpoint=endpoint,
            site=site,
            area=area,
            offset=[t - first for t, _ in arrivals],
            frames=[message for message in said if isinstance(message, DetectionFrame)],
            scans=[message for message in said if isinstance(message, RadioScan)],
            motions=[message for message in said if isinstance(message, MotionBatch)],
            kind="".join(type(message).__name__[0] for message in said).translate(str.maketrans("DRM", "fsm")),
            **more,
        )

    def messages(self) -> Iterator[tuple[float, Said]]:
        """Yield (offset, message) in order."""
        kinds: dict[str, Iterator[Said]] = {"f": iter(self.frames), "s": iter(self.scans), "m": iter(self.motions)}
        for offset, kind in zip(self.offset, self.kind, strict=True):
            yield offset, next(kinds[kind])


class Sent(msgspec.Struct, frozen=True):
    """What was sent.

    Attributes:
        trace: of each detection message, in order.
        sent: wall-clock time of each, s.
        late: how long after it was due each message of any kind was sent, s; empty without a clock.
        cpu_share: of one core, while sending.
    """

    trace: list[str]
    sent: list[float]
    late: list[float]
    cpu_share: float


def thinned(arrivals: Sequence[tuple[float, Said]], every: int) -> list[tuple[float, Said]]:
    """Return one of ``every`` frames of each camera and one of ``every`` scans of each phone; all reports of steps."""
    count: dict[tuple[type, str], int] = {}
    kept = []
    for t, message in arrivals:
        if not isinstance(message, MotionBatch):
            source = (type(message), message.camera if isinstance(message, DetectionFrame) else message.device)
            count[source] = count.get(source, -1) + 1
            if count[source] % every:
                continue
        kept.append((t, message))
    return kept


def looped(message: Said, seconds: float) -> Said:
    """Return the message as if all of it had happened ``seconds`` later."""
    if not isinstance(message, MotionBatch):
        return cast(Said, replace(message, t=message.t + seconds))
    return replace(
        message,
        t=message.t + seconds,
        t_start=message.t_start + seconds,
        step_t=[t + seconds for t in message.step_t],
        turn_t=[t + seconds for t in message.turn_t],
        revises_from=None if message.revises_from is None else message.revises_from + seconds,
    )


class _Sender:
    """Publishers of a load, one per key."""

    def __init__(self, bus: Bus, keys: Keys, live: bool) -> None:
        self._bus, self._keys, self._live = bus, keys, live
        self._publishers: dict[tuple[type, str], Publisher[Any]] = {}

    def of(self, message: Said) -> Publisher[Any]:
        """Return the publisher of a message's key."""
        kind = type(message)
        name = message.camera if isinstance(message, DetectionFrame) else message.device
        known = self._publishers.get((kind, name))
        if known is None:
            key = {DetectionFrame: self._keys.detections, RadioScan: self._keys.radio, MotionBatch: self._keys.motion}
            # Cameras rather drop a frame than wait for a crowded bus.
            known = self._bus.publisher(key[kind](name), kind, newest=self._live and kind is DetectionFrame)
            self._publishers[kind, name] = known
        return known

    def wait(self) -> None:
        """Wait until somebody listens to all of them.

        Raises:
            TimeoutError: nobody did in time.
        """
        deadline = time.monotonic() + READY_WITHIN
        while not all(publisher.matched for publisher in self._publishers.values()):
            if time.monotonic() > deadline:
                raise TimeoutError("nobody subscribes to the load")
            time.sleep(0.05)


def _by_clock(load: LoadFile, sender: _Sender) -> Sent:
    ready = [(offset, sender.of(said), msgspec.Raw(encode(said)), said) for offset, said in load.messages()]
    sender.wait()
    trace, sent, late = [], [], []
    begin, used = time.perf_counter(), time.process_time()
    for offset, publisher, body, said in ready:
        wait = begin + offset - time.perf_counter()
        if wait > 0.0:
            time.sleep(wait)
        left = publisher.publish(body)
        late.append(time.perf_counter() - begin - offset)
        if isinstance(said, DetectionFrame):
            trace.append(left.id)
            sent.append(left.sent)
    return Sent(trace, sent, late, (time.process_time() - used) / (time.perf_counter() - begin))


def _as_consumed(load: LoadFile, sender: _Sender, bus: Bus, keys: Keys) -> Sent:
    """Send as fast as fusion's chunk marks allow: no camera's frames may overtake each other."""
    inbox = bus.inbox()
    inbox.subscribe(keys.chunks(load.area), ChunkMark)
    for _, said in load.messages():
        sender.of(said)
    sender.wait()
    interval = load.period * len({frame.camera for frame in load.frames}) / len(load.frames)
    reached = 0.0
    trace, sent = [], []
    begin, used = time.perf_counter(), time.process_time()
    for number in range(load.rounds):
        for _, template in load.messages():
            said = looped(template, number * load.period)
            if isinstance(said, DetectionFrame):
                deadline = time.monotonic() + PATIENCE
                while reached and said.t > reached + BEHIND * interval:
                    for mark in inbox.receive(0.1):
                        reached = max(reached, mark.message.t)
                    if time.monotonic() > deadline:
                        raise TimeoutError("fusion no longer closes chunks")
                reached = reached or said.t
            left = sender.of(said).publish(said)
            if isinstance(said, DetectionFrame):
                trace.append(left.id)
                sent.append(left.sent)
    return Sent(trace, sent, [], (time.process_time() - used) / (time.perf_counter() - begin))


def drive(path: Path) -> Sent:
    """Send the load in a file, MessagePack, and return what was sent.

    Raises:
        TimeoutError: nobody subscribes, or fusion stopped.
    """
    load = msgspec.msgpack.decode(path.read_bytes(), type=LoadFile)
    keys = Keys(load.site)
    with ExitStack() as stack:
        bus = stack.enter_context(Bus([load.endpoint]))
        sender = _Sender(bus, keys, live=load.clock)
        return _by_clock(load, sender) if load.clock else _as_consumed(load, sender, bus, keys)


if __name__ == "__main__":
    Path(sys.argv[2]).write_bytes(msgspec.json.encode(drive(Path(sys.argv[1]))))
