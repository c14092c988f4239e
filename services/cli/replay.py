"""``atrium replay``: compute a recording's tracks anew and compare them bit for bit, or play it on a bus."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from services.cli.recording import INPUT_KINDS, STATE_KINDS, Consumed, Recording
from services.fusion.registry import DEFAULT_TRACKER
from services.fusion.replay import replay_steps
from shared.bus import Bus, Publisher
from shared.messages import ChunkMark, Message, Revision, TrackFrame, decode, encode
from shared.site import Site

__all__ = ["Verdict", "describe", "play", "verify"]


@dataclass(frozen=True)
class Verdict:
    """What came of comparing one area's recorded tracks, and their revisions, with those computed anew."""

    area: str
    frames: int
    revisions: int
    different: int
    first_difference: int | None
    missing_inputs: int
    unrecorded: int
    after_restart: int
    truncated: bool

    @property
    def identical(self) -> bool:
        """Whether every recorded frame and revision was reproduced to the byte."""
        return self.frames > 0 and not (self.different or self.missing_inputs or self.after_restart)

    def __str__(self) -> str:
        """Say it in one line."""
        words = f"area {self.area}: {self.frames} track frames and {self.revisions} revisions compared"
        if self.identical:
            words += ", all identical to the byte"
        elif self.different:
            words += f", {self.different} DIFFERENT, the first in chunk {self.first_difference}"
        if self.missing_inputs:
            words += f"; {self.missing_inputs} inputs are missing from the recording"
        if self.after_restart:
            words += f"; fusion was started anew, {self.after_restart} chunks after that are not compared"
        if self.truncated:
            words += "; the file ends in the middle, what followed is lost"
        if self.unrecorded:
            words += f"; {self.unrecorded} frames were not recorded"
        return words


def verify(recording: Recording, site: Site, radio_model: Path | None = None) -> list[Verdict]:
    """Recompute the tracks of every recorded area, with the trained radio model fusion had, if any, and compare."""
    return [_verify_area(recording, site, area, radio_model) for area in recording.areas()]


def play(recording: Recording, bus: Bus, pace: float, stopping: threading.Event) -> int:
    """Send the recorded sensor messages with their own keys, ``pace`` times as fast as they came; return how many."""
    publishers: dict[str, Publisher[Message]] = {}
    started: tuple[float, float] | None = None
    sent = 0
    for recorded in recording.messages():
        if not isinstance(recorded.message, INPUT_KINDS):
            continue
        now = time.monotonic()
        if started is None and not isinstance(recorded.message, STATE_KINDS):
            started = (now, recorded.sent)  # what was told long before the recording began sets no pace
        due = now if started is None else started[0] + (recorded.sent - started[1]) / pace
        if stopping.wait(max(0.0, due - now)):
            break
        if recorded.key not in publishers:
            publishers[recorded.key] = bus.publisher(recorded.key, type(recorded.message))
        publishers[recorded.key].publish(recorded.message)
        sent += 1
    return sent


def describe(recording: Recording) -> str:
    """Say in a few lines what a recording holds."""
    counts: Counter[str] = Counter()
    first = last = None
    for recorded in recording.messages():
        counts[type(recorded.message).__name__] += 1
        first, last = first or recorded.sent, recorded.sent
    lines = [f"{recording.path}: site {recording.site} ({recording.site_file})"]
    if first is not None and last is not None:
        begun = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(first))
        lines.append(f"  {last - first:.1f} s from {begun}{', cut off' if recording.truncated else ''}")
    lines += [f"  {count:7d} {name}" for name, count in sorted(counts.items())]
    return "\n".join(lines)


def _verify_area(recording: Recording, site: Site, area: str, radio_model: Path | None) -> Verdict:
    chunks: deque[Consumed] = deque()
    after_restart = 0

    def recorded_chunks() -> Iterator[tuple[ChunkMark, tuple[Message, ...]]]:
        nonlocal after_restart
        process = None
        for consumed in recording.consumed(area):
            process = process or consumed.process
            if consumed.process != process:
                after_restart += 1
                continue
            chunks.append(consumed)
            yield consumed.mark, consumed.inputs

    tracker = next((one.tracks.tracker for one in recording.consumed(area) if one.tracks), DEFAULT_TRACKER)
    recorded_revisions = recording.revisions(area)
    different, first_difference, frames, revisions, unrecorded, missing = 0, None, 0, 0, 0, 0
    state = recording.state(area)
    for frame, revision in replay_steps(recorded_chunks(), site, area, state, tracker, radio_model=radio_model):
        consumed = chunks.popleft()
        while consumed.mark.chunk != frame.chunk:  # older than the state the recording begins with
            consumed = chunks.popleft()
        missing += consumed.missing
        if consumed.tracks is None:
            unrecorded += 1
            continue
        frames += 1
        told = recorded_revisions.get(frame.chunk)
        revisions += told is not None
        # A revision that was made and not recorded is like a frame that was not recorded: nothing to compare with.
        wrong = told is not None and (revision is None or not _same(revision, told))
        unrecorded += revision is not None and told is None
        if wrong or not _same(frame, consumed.tracks):
            different += 1
            first_difference = frame.chunk if first_difference is None else first_difference
    return Verdict(
        area, frames, revisions, different, first_difference, missing, unrecorded, after_restart, recording.truncated
    )


def _same(one: TrackFrame | Revision, other: TrackFrame | Revision) -> bool:
    # Once over the wire and back, as what was recorded: there, whole numbers become floats.
    return encode(decode(encode(one), type(one))) == encode(other)
