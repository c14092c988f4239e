"""Run a tracker of fusion over a record, off line: the chunks a live run would close, without bus or wall clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from benchmarks.world_record import WorldRecord
from services.fusion.area_view import AreaView
from services.fusion.chunks import PERIOD, Chunker, ChunkerSettings, period_of
from services.fusion.registry import DEFAULT_TRACKER, make_tracker
from services.fusion.tracker import Chunk
from shared.messages import DetectionFrame, MotionBatch, RadioScan, Revision, TrackFrame

__all__ = ["FusionRun", "chunks_of", "run_fusion"]


@dataclass(frozen=True, slots=True)
class FusionRun:
    """What a tracker made of a record.

    Attributes:
        frames: one per chunk.
        revisions: in order, of those chunks that brought one.
        seconds: of computing, per chunk; in the order of ``frames``.
    """

    frames: Sequence[TrackFrame]
    revisions: Sequence[Revision]
    seconds: Sequence[float]


def run_fusion(
    record: WorldRecord,
    tracker: str = DEFAULT_TRACKER,
    seed: int = 0,
    view: AreaView | None = None,
    progress: Callable[[float], None] = lambda t: None,
) -> FusionRun:
    """Return the tracks of one area.

    Args:
        record: what its sensors said; of its site only what trackers may know is used.
        tracker: its name in the registry.
        seed: of trackers that draw.
        view: what it knows of its area before it starts, where that is more than the site file says.
        progress: called with the time of each chunk.
    """
    machine = make_tracker(tracker, view or AreaView.of(record.site, record.area), seed)
    frames, revisions, seconds = [], [], []
    for chunk in chunks_of(record, period_of(machine.cycle)):
        begun = time.perf_counter()
        frames.append(machine.step(chunk))
        seconds.append(time.perf_counter() - begun)
        revision = machine.revision()
        if revision is not None:
            revisions.append(revision)
        progress(chunk.t_end)
    return FusionRun(frames, revisions, seconds)


def chunks_of(record: WorldRecord, period: float = PERIOD) -> Iterator[Chunk]:
    """Yield the chunks a live run would close, message by message in the order in which they reached the bus.

    So a frame or a scan that comes late is late, and what comes hours later is dropped, as in a live run.
    """
    chunker = Chunker(ChunkerSettings(period=period))
    for _, message in record.arrivals:
        match message:
            case DetectionFrame():
                for closed in chunker.add_frame(message, ""):
                    yield closed.chunk
            case RadioScan():
                chunker.add_scan(message, "")
            case MotionBatch():
                chunker.add_motion(message, "")
