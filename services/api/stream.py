"""Server-sent events: each event is encoded once and shared by all readers; a slow reader gets the newest, not all.

Lives in the HTTP event loop. Tracks and camera statuses are state: a reader that falls behind finds only the newest of
each area or camera. Alerts are events: they queue, up to a bound, and a reader that reconnects with ``Last-Event-ID``
is told is told what it missed. Revisions queue like them and are not told again.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import math
from collections import deque
from collections.abc import AsyncIterator, Callable

import msgspec
from prometheus_client import Counter, Gauge

from services.api.replies import CameraReport, TrackColumns
from shared.messages import Alert, Revision, TrackFrame

__all__ = ["Hub", "Reader", "alert_event", "camera_event", "revision_event", "tracks_event"]

READERS = Gauge("atrium_stream_readers", "Streams open now")
SKIPPED = Counter("atrium_stream_skipped_total", "Events a slow reader did not get", ["event"])

ALERTS_WAITING = 1000
"""Alerts that wait for a slow reader, and so many revisions."""


def tracks_event(frame: TrackFrame) -> bytes:
    """Return the ``tracks`` event of one frame."""
    columns = TrackColumns(
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
        probability=frame.probability,
        accuracy=[_worst_sigma(*covariance) for covariance in frame.covariance],
    )
    return b"event: tracks\ndata: " + msgspec.json.encode(columns) + b"\n\n"


def revision_event(revision: Revision) -> bytes:
    """Return the ``revision`` event: what is now thought of some devices' last seconds."""
    return b"event: revision\ndata: " + msgspec.json.encode(revision) + b"\n\n"


def alert_event(alert: Alert) -> bytes:
    """Return the ``alert`` event; its id is the alert's, so that a reader can resume after it."""
    return b"event: alert\nid: " + alert.id.encode() + b"\ndata: " + msgspec.json.encode(alert) + b"\n\n"


def camera_event(report: CameraReport) -> bytes:
    """Return the ``camera`` event of one status."""
    return b"event: camera\ndata: " + msgspec.json.encode(report) + b"\n\n"


class Reader:
    """What one client has still to be sent; never more than one event per area and camera and a bound of alerts."""

    def __init__(self, keep_alive: float, events: frozenset[str], area: str | None) -> None:
        self._keep_alive = keep_alive
        self._events = events
        self._area = area
        self._newest: dict[tuple[str, str], bytes] = {}
        self._waiting: dict[str, deque[bytes]] = {"alert": deque(), "revision": deque()}
        """Events that must not replace each other."""
        self._changed = asyncio.Event()
        self._closed = False

    def offer(self, event: str, subject: str, area: str, payload: bytes) -> None:
        """Queue one event for this client, in place of an older one of the same subject where that is state."""
        if event not in self._events or (self._area is not None and area != self._area):
            return
        if event in self._waiting:
            queue = self._waiting[event]
            if len(queue) >= ALERTS_WAITING:
                queue.popleft()
                SKIPPED.labels(event).inc()
            queue.append(payload)
        else:
            if self._newest.pop((event, subject), None) is not None:
                SKIPPED.labels(event).inc()
            self._newest[event, subject] = payload
        self._changed.set()

    def drop(self, event: str) -> None:
        """Drop what waits of one kind of queued event."""
        self._waiting[event].clear()

    def close(self) -> None:
        """End the stream after what is being sent."""
        self._closed = True
        self._changed.set()

    async def events(self) -> AsyncIterator[bytes]:
        """Yield what is to be sent, a comment when there was nothing for a while, until closed."""
        yield b": atrium stream\nretry: 1000\n\n"
        while not self._closed:
            if not self._changed.is_set():
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(self._keep_alive):
                        await self._changed.wait()
            self._changed.clear()
            waiting = [*itertools.chain(*self._waiting.values()), *self._newest.values()]
            for queue in self._waiting.values():
                queue.clear()
            self._newest.clear()
            yield b"".join(waiting) if waiting else b": still here\n\n"


class Hub:
    """Hands events to all readers, tracks of each area at no more than ``rate`` per second.

    Args:
        rate: ``tracks`` events per second and area.
        keep_alive: seconds of silence after which a comment is sent.
        most: readers at once.
    """

    def __init__(self, rate: float, keep_alive: float, most: int) -> None:
        self._interval = 1.0 / rate
        self._keep_alive = keep_alive
        self._most = most
        self._readers: set[Reader] = set()
        self._next: dict[str, float] = {}
        self._held: dict[str, Callable[[], bytes]] = {}
        self._closed = False

    @property
    def full(self) -> bool:
        """Whether no further reader is taken now."""
        return self._closed or len(self._readers) >= self._most

    def join(self, events: frozenset[str], area: str | None) -> Reader:
        """Return a new reader of these events, of one area or of all."""
        reader = Reader(self._keep_alive, events, area)
        self._readers.add(reader)
        READERS.inc()
        return reader

    def leave(self, reader: Reader) -> None:
        """Forget a reader."""
        if reader in self._readers:
            self._readers.discard(reader)
            READERS.dec()

    def tracks(self, frame: TrackFrame) -> None:
        """Send a frame now, or when its area's turn comes, unless a newer one is there by then."""
        loop = asyncio.get_running_loop()
        now = loop.time()
        due = self._next.get(frame.area, now)
        waiting = frame.area in self._held
        self._held[frame.area] = lambda: tracks_event(frame)
        if waiting:
            return
        if due <= now:
            self._send_tracks(frame.area)
        else:
            loop.call_at(due, self._send_tracks, frame.area)

    def send(self, event: str, subject: str, area: str, payload: bytes) -> None:
        """Hand one event to every reader."""
        for reader in self._readers:
            reader.offer(event, subject, area, payload)

    def drop(self, event: str) -> None:
        """Drop what of one kind of queued event waits for readers: somebody in it withdrew consent."""
        for reader in self._readers:
            reader.drop(event)

    def close(self) -> None:
        """End all streams: the process is stopping."""
        self._closed = True
        for reader in self._readers:
            reader.close()

    def _send_tracks(self, area: str) -> None:
        encode = self._held.pop(area, None)
        if encode is None:
            return
        now = asyncio.get_running_loop().time()
        self._next[area] = max(self._next.get(area, now), now - self._interval) + self._interval
        if self._readers:
            self.send("tracks", area, area, encode())


def _worst_sigma(xx: float, xy: float, yy: float) -> float:
    middle, half = (xx + yy) / 2.0, (xx - yy) / 2.0
    return round(math.sqrt(max(middle + math.hypot(half, xy), 0.0)), 3)
