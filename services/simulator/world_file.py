"""A world as a file: one JSON object per line, in order of arrival, for who wants to look or bring their own tracker.

``{"kind": "detections" | "phone" | "truth", "t": arrival in world seconds, "message": …}``; detections and truth are
the bus's messages with times in world seconds, a phone's message is the body it would post to the gateway.
"""

from __future__ import annotations

import gzip
from collections import Counter
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import IO, cast

import msgspec

from services.simulator.phone_batch import PhoneBatch
from services.simulator.posting import body_of
from services.simulator.world import World, truth_messages
from shared.messages import DetectionFrame
from shared.truth import GroundTruth

__all__ = ["write_world"]


def write_world(world: World, seconds: float, out: Path | None, progress: Callable[[float], None]) -> Counter[str]:
    """Make a world, write it, and return how much of everything there was.

    Args:
        world: not made yet.
        seconds: how long.
        out: the file to write, compressed where its name ends in ``.gz``; None writes nothing.
        progress: called with the seconds made so far.
    """
    counts: Counter[str] = Counter()
    with _opened(out) as lines:
        while world.made < seconds:
            block = world.next_block()
            progress(min(world.made, seconds))
            entries: list[tuple[float, str, DetectionFrame | PhoneBatch | GroundTruth]] = []
            for t, frame in block.frames:
                counts["frames"] += 1
                counts["detections"] += len(frame.x)
                entries.append((t, "detections", frame))
            for batch in block.batches:
                counts["batches"] += 1
                counts["inertial samples"] += 0 if batch.inertial is None else len(batch.inertial.t)
                counts["radio scans"] += len(batch.scans)
                counts["radio readings"] += sum(len(scan.rssi) for scan in batch.scans)
                entries.append((batch.arrival, "phone", batch))
            for truth in truth_messages(world, block):
                counts["positions of people"] += len(truth.person)
                entries.append((truth.t, "truth", truth))
            if lines is not None:
                for entry in sorted(entries, key=lambda entry: entry[0]):
                    lines.write(_line(*entry))
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
