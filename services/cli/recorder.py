"""``atrium record``: write what fusion may consume, its marks and its tracks to an MCAP file until told to stop."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from services.cli.recording import RecordingWriter
from shared.bus import DROPPED, Bus
from shared.keys import Keys
from shared.messages import (
    Alert,
    CameraStatus,
    ChunkMark,
    DetectionFrame,
    Message,
    MotionBatch,
    RadioScan,
    TrackFrame,
)
from shared.site import Site

__all__ = ["record"]

QUEUE = 200_000


class _State(msgspec.Struct):
    chunk: int


def record(
    bus: Bus,
    site: Site,
    site_file: Path,
    out: Path,
    stopping: threading.Event,
    progress: Callable[[dict[str, int]], None] = lambda counts: None,
) -> dict[str, int]:
    """Record the site's bus into ``out`` until ``stopping`` is set.

    When fusion is already running its state is stored first, so that the recording replays exactly from its first
    whole chunk on.

    Returns:
        How many messages of each kind were written, and ``dropped``, how many the recorder could not keep.
    """
    keys = Keys(site.site)
    inbox = bus.inbox(capacity=QUEUE)
    lost_before = _lost()
    kinds: list[tuple[str, type[Message], bool]] = [
        (keys.detections(), DetectionFrame, False),
        (keys.radio(), RadioScan, False),
        (keys.motion(), MotionBatch, False),
        (keys.chunks(), ChunkMark, False),
        (keys.tracks(), TrackFrame, False),
        (keys.camera_status(), CameraStatus, True),
        (keys.alert(), Alert, False),
    ]
    for key, kind, cached in kinds:
        inbox.subscribe(key, kind, cached=cached)
    with RecordingWriter(out, site.site, site_file.resolve()) as writer:
        for key, answer in bus.ask(keys.fusion_state(), timeout=2.0):
            if msgspec.json.decode(answer, type=_State).chunk >= 0:
                writer.attach_state(key.split("/")[-2], answer, time.time())
        next_report = 0.0
        while True:
            last_round = stopping.is_set()
            for delivery in inbox.receive(timeout=0.2):
                writer.write(delivery.key, delivery.message, delivery.trace)
            if time.monotonic() >= next_report:
                next_report = time.monotonic() + 1.0
                progress(dict(writer.counts))
            if last_round:
                break
        dropped = int(_lost() - lost_before)
        writer.close(dropped)
        return {**writer.counts, "dropped": dropped}


def _lost() -> float:
    return sum(
        sample.value for metric in DROPPED.collect() for sample in metric.samples if sample.name.endswith("_total")
    )
