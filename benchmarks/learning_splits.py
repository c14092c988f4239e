"""Which part of a run teaches, and which later part judges? [ravel-thesis §11.4]"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TypeVar

from benchmarks.world_record import Truth, WorldRecord
from benchmarks.world_run import EPOCH
from shared.messages import MotionBatch, RadioScan

__all__ = ["Split", "part_of", "splits"]

P = TypeVar("P", RadioScan, MotionBatch)

TRAINING, TEST = 1200.0, 600.0
"""Seconds, as in the study."""
COUNT = 5


@dataclasses.dataclass(frozen=True)
class Split:
    """A training part and the test part that follows it at once; seconds since the world began."""

    start: float
    turn: float
    end: float


def splits(seconds: float, training: float = TRAINING, test: float = TEST, count: int = COUNT) -> list[Split]:
    """Return ``count`` splits of a run, evenly spaced from its beginning to its end; they overlap.

    Raises:
        ValueError: the run is shorter than one split.
    """
    spare = seconds - training - test
    if spare < 0.0:
        raise ValueError(f"seconds: {seconds:g}; allowed: at least {training + test:g}, training and test together")
    starts = [spare * number / max(count - 1, 1) for number in range(count)]
    return [Split(start, start + training, start + training + test) for start in starts]


def part_of(record: WorldRecord, start: float, end: float) -> WorldRecord:
    """Return what reached Atrium from ``start`` to ``end``, seconds since the world began, and the truth of that time.

    What was measured before ``start`` and arrives later is left out: nothing that taught may judge.
    """
    begin, stop = EPOCH + start, EPOCH + end
    truth = record.truth
    rows = (truth.t >= begin) & (truth.t < stop)
    return dataclasses.replace(
        record,
        arrivals=[(t, message) for t, message in record.arrivals if begin <= t < stop and message.t >= begin],
        frames=[frame for frame in record.frames if begin <= frame.t < stop],
        scans={device: _between(messages, begin, stop) for device, messages in record.scans.items()},
        motions={device: _between(messages, begin, stop) for device, messages in record.motions.items()},
        truth=Truth(truth.t[rows], truth.person, truth.device, truth.position[rows], truth.in_view[rows]),
    )


def _between(messages: Sequence[P], begin: float, stop: float) -> list[P]:
    return [message for message in messages if begin <= message.t < stop]
