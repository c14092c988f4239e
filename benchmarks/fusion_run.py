"""Run a tracker of fusion over a record, off line: the chunks a live run would close, without bus or wall clock."""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from benchmarks.world_record import WorldRecord
from services.fusion.area_view import AreaView
from services.fusion.chunks import PERIOD
from services.fusion.registry import DEFAULT_TRACKER, make_tracker
from services.fusion.tracker import Chunk
from shared.messages import DetectionFrame, MotionBatch, RadioScan, TrackFrame

__all__ = ["FusionRun", "chunks_of", "run_fusion"]


@dataclass(frozen=True, slots=True)
class FusionRun:
    """What a tracker made of a record.

    Attributes:
        frames: one per chunk.
        seconds: of computing, per chunk; in the order of ``frames``.
    """

    frames: Sequence[TrackFrame]
    seconds: Sequence[float]


def run_fusion(
    record: WorldRecord,
    tracker: str = DEFAULT_TRACKER,
    seed: int = 0,
    progress: Callable[[float], None] = lambda t: None,
) -> FusionRun:
    """Return the tracks of one area.

    Args:
        record: what its sensors said; of its site only what trackers may know is used.
        tracker: its name in the registry.
        seed: of trackers that draw.
        progress: called with the time of each chunk.
    """
    machine = make_tracker(tracker, AreaView.of(record.site, record.area), seed)
    frames, seconds = [], []
    for chunk in chunks_of(record):
        begun = time.perf_counter()
        frames.append(machine.step(chunk))
        seconds.append(time.perf_counter() - begun)
        progress(chunk.t_end)
    return FusionRun(frames, seconds)


def chunks_of(record: WorldRecord) -> Iterator[Chunk]:
    """Yield the chunks in which frames lie; scans and motion reports enter with the first chunk that ends after them.

    As in a live run with little delay; what phones send hours later does not enter at all.
    """
    scans = list(heapq.merge(*record.scans.values(), key=lambda scan: scan.t))
    motions = list(heapq.merge(*record.motions.values(), key=lambda motion: motion.t))
    s = m = f = 0
    frames = sorted(record.frames, key=lambda frame: (frame.t, frame.camera))
    while f < len(frames):
        index = int(frames[f].t // PERIOD)
        end = (index + 1) * PERIOD
        mine: list[DetectionFrame] = []
        while f < len(frames) and frames[f].t < end:
            mine.append(frames[f])
            f += 1
        heard: list[RadioScan] = []
        while s < len(scans) and scans[s].t < end:
            heard.append(scans[s])
            s += 1
        walked: list[MotionBatch] = []
        while m < len(motions) and motions[m].t < end:
            walked.append(motions[m])
            m += 1
        yield Chunk(index, index * PERIOD, end, frames=tuple(mine), scans=tuple(heard), motions=tuple(walked))
