"""From a run off line to the stretches that learning would have cut from the same messages on the bus, and judged."""

from __future__ import annotations

import heapq
from collections.abc import Iterator

from benchmarks.fusion_run import FusionRun
from benchmarks.world_record import WorldRecord
from services.fusion.area_view import AreaView
from services.learning.tracks.assembler import StretchAssembler
from services.learning.tracks.quality import QualityJudge, SightScore
from services.learning.tracks.stretch import Stretch
from services.learning.tracks.verdict import Verdict
from shared.messages import DetectionFrame, Message, MotionBatch, RadioScan, Revision, TrackFrame

__all__ = ["cut_of", "heard_of", "stretches_of"]

EVERY = 5.0
"""Seconds between two looks at what has ended."""


def heard_of(record: WorldRecord, run: FusionRun) -> Iterator[tuple[float, Message]]:
    """Yield when learning hears what of an area: what sensors say, and what fusion makes of it."""
    said = ((t, 0, message) for t, message in record.arrivals)
    frames = ((frame.t, 1, frame) for frame in run.frames)
    revisions = ((revision.t, 2, revision) for revision in run.revisions)
    for t, _, message in heapq.merge(said, frames, revisions, key=lambda entry: entry[:2]):
        yield t, message


def stretches_of(record: WorldRecord, run: FusionRun, view: AreaView) -> Iterator[tuple[Stretch, Verdict]]:
    """Yield the stretches of a run over a record as they end, and what is thought of each under a view's radio."""
    judge = QualityJudge(len(view.radio.names))
    for stretch in cut_of(record, run, view):
        yield stretch, judge.judge(stretch, view.radio, view.shadowing)


def cut_of(record: WorldRecord, run: FusionRun, view: AreaView) -> Iterator[Stretch]:
    """Yield the stretches of a run over a record as they end; the last seconds are not settled and are left out."""
    assembler = StretchAssembler(view.radio.names)
    sight = SightScore(view.views)
    looked = run.frames[0].t if run.frames else 0.0
    for t, message in heard_of(record, run):
        match message:
            case DetectionFrame():
                sight.take_detections(message)
            case RadioScan():
                assembler.take_scan(message)
            case MotionBatch():
                assembler.take_motion(message)
            case TrackFrame():
                assembler.take_frame(message, sight.score(message))
            case Revision():
                assembler.take_revision(message)
        if t >= looked + EVERY:
            looked = t
            yield from assembler.close()
    yield from assembler.close()
