"""A world as a file: one JSON object per line, in order of arrival, for who wants to look or bring their own tracker.

``{"kind": "detections" | "phone" | "truth", "t": arrival in world seconds, "message": …}``; detections and truth are
the bus's messages with times in world seconds, a phone's message is the body it would post to the gateway.
"""

from __future__ import annotations

import gzip
from collections import Counter, deque
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import IO, cast

import msgspec

from services.simulator.phones.phone_batch import PhoneBatch
from services.simulator.phones.posting import body_of
from services.simulator.world import World, WorldBlock, truth_messages
from shared.messages import DetectionFrame
from shared.truth import GroundTruth

__all__ = ["write_world"]


def write_world(world: World, seconds: float, out: Path | None, progress: Callable[[float], None]) -> Counter[str]:
    """Make a world, write it, and return how much of everything there was.

    Args:
        world: not made yet.
        seconds: how long; what arrives later is not counted.
        out: the file to write, compressed where its name ends in ``.gz``; None writes nothing.
        progress: called with the seconds made so far.
    """
    counts: Counter[str] = Counter()
    truths: deque[GroundTruth] = deque()

    def made(block: WorldBlock) -> None:
        progress(min(block.end, seconds))
        truths.extend(truth_messages(world, block))

    with _opened(out) as lines:

        def write(t: float, kind: str, message: DetectionFrame | PhoneBatch | GroundTruth) -> None:
            if lines is not None:
                lines.write(_line(t, kind, message))

        def write_truth(until: float) -> None:
            while truths and truths[0].t < until:
                truth = truths.popleft()
                counts["positions of people"] += len(truth.person)
                write(truth.t, "truth", truth)

        for arrival in world.arrivals(seconds, made):
            write_truth(arrival.t)
            message = arrival.message
            if isinstance(message, DetectionFrame):
                counts["frames"] += 1
                counts["detections"] += len(message.x)
                write(arrival.t, "detections", message)
            else:
                counts["batches"] += 1
                counts["inertial samples"] += 0 if message.inertial is None else len(message.inertial.t)
                counts["radio scans"] += len(message.scans)
                counts["radio readings"] += sum(len(scan.rssi) for scan in message.scans)
                write(arrival.t, "phone", message)
        write_truth(seconds)
    return counts


def _opened(out: Path | None) -> AbstractContextManager[IO[bytes] | None]:
    if out is None:
        return nullcontext()
    return cast("IO[bytes]", gzip.open(out, "wb")) if out.suffix == ".gz" else out.open("wb")


def _line(t: float, kind: str, message: DetectionFrame | PhoneBatch | GroundTruth) -> bytes:
    if isinstance(message, PhoneBatch):
        line = {"kind": kind, "t": t, "person": message.person, "message": body_of(message)}
    else:
        line = {"kind": kind, "t": t, "message": message}
    return msgspec.json.encode(line) + b"\n"
