"""Streams over the event log: each event is encoded once and shared by all readers, and no reader holds a queue.

Lives in the HTTP event loop. A reader is a place in the log. One of the present (``lossless`` false) that falls behind
is told the newest of each area, camera or zone count only, but every alert and revision; a lossless one is told
everything in order. One whose place has left the log, or that takes nothing for too long, is dropped and counted.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
from collections.abc import AsyncIterator, Callable

import msgspec
from prometheus_client import Counter, Gauge

from services.api.accuracy import accuracy_of
from services.api.event_log import STATE, EventLog, Framing
from services.api.problems import Problem
from services.api.replies import TrackColumns
from services.api.selection import Selection
from services.api.track_memory import Since
from shared.erased import Erased
from shared.messages import TrackFrame

__all__ = ["DROPPED", "Hub", "Reader", "track_columns"]

READERS = Gauge("atrium_stream_readers", "Streams open now")
SKIPPED = Counter("atrium_stream_skipped_total", "Events a slow reader did not get, being told newer ones", ["event"])
DROPPED = Counter("atrium_stream_dropped_total", "Streams ended because the client read too slowly", ["reason"])
HELD = Gauge("atrium_stream_log_bytes", "Memory the event log may take")

LARGEST_SEND = 1 << 17
"""Bytes after which a reader is handed what there is so far: about what is held for each that reads nothing."""
LONGEST_LOOK = 500
"""Events after which a reader lets others have their turn, wanted or not."""
KEY_LOOKED_AT, KEY_AT_LATEST = 1.0, 2.0
"""Seconds after which a reader's key is looked at again, with the next event or without one."""
_OVERTAKEN = Problem(
    type="urn:atrium:event-gone",
    title="Read too slowly",
    status=410,
    detail="what comes next is no longer held: begin anew",
)
_STOPPING = Problem(
    type="urn:atrium:stopping",
    title="Stopping",
    status=503,
    detail="the API is stopping: come back in a moment",
)


def track_columns(frame: TrackFrame, since: Since) -> TrackColumns:
    """Return a frame as the stream tells it."""
    return TrackColumns(
        area=frame.area,
        t=frame.t,
        floor=frame.floor,
        track=frame.track,
        x=frame.x,
        y=frame.y,
        vx=frame.vx,
        vy=frame.vy,
        state=list(frame.state),
        device=frame.device,
        device_since=[
            None if device is None or (track, device) not in since else round(since[track, device], 1)
            for track, device in zip(frame.track, frame.device, strict=True)
        ],
        probability=frame.probability,
        quality=[round(quality, 2) for quality in frame.quality],
        accuracy=[accuracy_of(covariance) for covariance in frame.covariance],
    )


class Reader:
    """One client's place in the log.

    Args:
        log: what it reads.
        selection: what it wants.
        framing: how events travel to it.
        after: id of the event it has read last.
        lossless: whether it is told everything, or of state the newest only.
        keep_alive: seconds of silence after which it is told that there is nothing.
        refused: says why its key opens nothing any more: the stream ends with it, within two seconds.
    """

    def __init__(
        self,
        log: EventLog,
        selection: Selection,
        framing: Framing,
        after: int,
        lossless: bool,
        keep_alive: float,
        refused: Callable[[], Problem | None] = lambda: None,
    ) -> None:
        self._log = log
        self._selection = selection
        self._framing = framing
        self._after = after
        self._lossless = lossless
        self._keep_alive = keep_alive
        self._refused = refused
        self._changed = asyncio.Event()
        self._closed = False
        self.ended: Problem | None = None
        """Why the stream ended; None: it goes on, or its client left."""

    def wake(self) -> None:
        """There is something new."""
        self._changed.set()

    def close(self, why: Problem | None = None) -> None:
        """End the stream after what is being sent, and say why."""
        self._closed, self.ended = True, why
        self._changed.set()

    async def chunks(self) -> AsyncIterator[bytes]:
        """Yield events as they travel, nothing (``b""``) after a silence, until closed, overtaken or its key ends.

        What it is told last, unless its client left, is the event ``ended``: why.
        """
        loop = asyncio.get_running_loop()
        told, looked = loop.time(), -math.inf
        while not self._closed:
            if loop.time() >= looked + KEY_LOOKED_AT:
                looked = loop.time()
                if (refusal := self._refused()) is not None:
                    self.close(refusal)
                    break
            self._changed.clear()
            if self._log.refusal(self._after) is not None:
                DROPPED.labels("overtaken").inc()
                self.close(_OVERTAKEN)
                break
            chunk = self._next()
            if not chunk:
                if self._after == self._log.newest:
                    with contextlib.suppress(TimeoutError):
                        async with asyncio.timeout_at(min(told + self._keep_alive, looked + KEY_AT_LATEST)):
                            await self._changed.wait()
                else:
                    await asyncio.sleep(0)
                if loop.time() < told + self._keep_alive:
                    continue
            yield chunk
            told = loop.time()
        if self.ended is not None:
            yield self._framing(None, "ended", msgspec.json.encode(self.ended))

    def _next(self) -> bytes:
        """Return what comes next, up to a size and a number, and go on behind it."""
        told: dict[object, bytes] = {}
        size = 0
        for entry in itertools.islice(self._log.after(self._after), LONGEST_LOOK):
            self._after = entry.id
            framed = self._selection.framed(entry, self._framing)
            if framed is None:
                continue
            key: object = entry.id
            if entry.event in STATE and not self._lossless:
                key = (entry.event, entry.subject)
                older = told.pop(key, b"")
                if older:
                    size -= len(older)
                    SKIPPED.labels(entry.event).inc()
            told[key] = framed
            size += len(framed)
            if size >= LARGEST_SEND:
                break
        return b"".join(told.values())


class Hub:
    """Writes the log, tracks of each area at no more than ``rate`` per second, and wakes all readers.

    Args:
        log: what is written.
        rate: ``tracks`` events per second and area.
        keep_alive: seconds of silence after which a reader is told that there is nothing.
        most: readers at once.
        most_of_one: readers at once of one account; as many as there may be unless told.
    """

    def __init__(
        self, log: EventLog, rate: float, keep_alive: float, most: int, most_of_one: int | None = None
    ) -> None:
        self.log = log
        self._interval = 1.0 / rate
        self._keep_alive = keep_alive
        self._most = most
        self.most_of_one = most if most_of_one is None else min(most, most_of_one)
        self._readers: dict[Reader, str] = {}
        """And whose they are."""
        self._next: dict[str, float] = {}
        self._held: dict[str, tuple[TrackFrame, Since]] = {}
        self._closed = False
        HELD.set_function(lambda: float(log.bytes))

    @property
    def full(self) -> bool:
        """Whether no further reader is taken now."""
        return self._closed or len(self._readers) >= self._most

    def full_for(self, account: str) -> bool:
        """Whether no further reader of this key or person is taken now."""
        return sum(whose == account for whose in self._readers.values()) >= self.most_of_one

    def join(
        self,
        selection: Selection,
        framing: Framing,
        after: int | None = None,
        lossless: bool = False,
        refused: Callable[[], Problem | None] = lambda: None,
        account: str = "",
    ) -> Reader:
        """Return a new reader of what comes after event ``after``, None: from now on, until its key is refused."""
        behind = self.log.newest if after is None else after
        reader = Reader(self.log, selection, framing, behind, lossless, self._keep_alive, refused)
        self._readers[reader] = account
        READERS.inc()
        return reader

    def leave(self, reader: Reader) -> None:
        """Forget a reader."""
        if reader in self._readers:
            del self._readers[reader]
            READERS.dec()

    def tracks(self, frame: TrackFrame, since: Since) -> None:
        """Tell a frame now, or when its area's turn comes, unless a newer one is there by then."""
        loop = asyncio.get_running_loop()
        now = loop.time()
        due = self._next.get(frame.area, now)
        waiting = frame.area in self._held
        self._held[frame.area] = frame, since
        if waiting:
            return
        if due <= now:
            self._send_tracks(frame.area)
        else:
            loop.call_at(due, self._send_tracks, frame.area)

    def send(
        self, event: str, subject: str, message: msgspec.Struct, area: str | None = None, zone: str | None = None
    ) -> int:
        """Write one event, wake every reader, and return its id."""
        entry = self.log.append(event, subject, area, zone, msgspec.json.encode(message))
        for reader in self._readers:
            reader.wake()
        return entry.id

    def erase(self, device: str) -> None:
        """Take a device whose consent was withdrawn out of what is not yet sent."""
        self.log.erase(device)
        erased = Erased()
        erased.add(device)
        self._held = {area: (erased.from_tracks(frame), since) for area, (frame, since) in self._held.items()}

    def close(self) -> None:
        """End all streams: the process is stopping."""
        self._closed = True
        for reader in self._readers:
            reader.close(_STOPPING)

    def _send_tracks(self, area: str) -> None:
        held = self._held.pop(area, None)
        if held is None:
            return
        now = asyncio.get_running_loop().time()
        self._next[area] = max(self._next.get(area, now), now - self._interval) + self._interval
        self.send("tracks", area, track_columns(*held), area)
