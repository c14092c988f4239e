"""From a run off line to the stretches that learning would have cut from the same messages on the bus."""

from __future__ import annotations

import heapq
from collections.abc import Iterator

from benchmarks.fusion_run import FusionRun
from benchmarks.world_record import WorldRecord
from services.learning.tracks.assembler import StretchAssembler
from services.learning.tracks.stretch import Stretch
from shared.messages import DetectionFrame, MotionBatch, RadioScan, Revision, TrackFrame

__all__ = ["stretches_of"]

EVERY = 5.0
"""Seconds between two looks at what has ended."""


def stretches_of(record: WorldRecord, run: FusionRun) -> Iterator[Stretch]:
    """Yield the stretches of a run over a record, as they end; the last seconds are not settled and are left out."""
    assembler = StretchAssembler([point.id for point in record.site.access_points])
    phones = ((t, 0, message) for t, message in record.arrivals if not isinstance(message, DetectionFrame))
    frames = ((frame.t, 1, frame) for frame in run.frames)
    revisions = ((revision.t, 2, revision) for revision in run.revisions)
    looked = run.frames[0].t if run.frames else 0.0
    for t, _, message in heapq.merge(phones, frames, revisions, key=lambda entry: entry[:2]):
        match message:
            case RadioScan():
                assembler.take_scan(message)
            case MotionBatch():
                assembler.take_motion(message)
            case TrackFrame():
                assembler.take_frame(message)
            case Revision():
                assembler.take_revision(message)
        if t >= looked + EVERY:
            looked = t
            yield from assembler.close()
    yield from assembler.close()
