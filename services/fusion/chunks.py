"""When is a chunk of time complete? Only cameras decide; phones are never waited for.

Time is cut into chunks of one period, numbered from the epoch. A chunk closes when every live camera has passed its
end, or when some camera is ``lateness`` ahead of it. A camera has passed the end when its next frame cannot come before
it: so a lone camera's frame closes its chunk at once. Pure: it knows no clock but the messages'.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from services.fusion.tracker import Chunk
from shared.messages import DetectionFrame, Erasure, MotionBatch, RadioModelUpdate, RadioScan

__all__ = ["PERIOD", "Chunker", "ChunkerSettings", "Closed", "period_of"]

PERIOD = 1.0 / 15.0
P = TypeVar("P", RadioScan, MotionBatch)


def period_of(cycle: float) -> float:
    """Return how long the chunks last that a tracker of this cycle is stepped with, seconds."""
    return cycle or PERIOD


@dataclass(frozen=True)
class ChunkerSettings:
    """How long fusion waits and what it still takes; all in seconds of event time."""

    period: float = PERIOD
    lateness: float = 0.15
    """How far the fastest camera may be ahead before the others are no longer waited for."""
    oldest_frame: float = 0.5
    """A frame that came after its chunk closed goes into the next one unless it is older than this."""
    silent: float = 2.0
    """A camera this far behind the newest one (or three of its own intervals) is no longer waited for."""
    oldest_phone: float = 5.0
    """Radio and motion older than this are left to the services that look back."""
    ahead: float = 2.0
    """A frame this far ahead of all cameras (or two of its camera's own intervals) is not believed at once."""
    agree: int = 2
    """Frames in a row that must tell the same unlikely time, nobody else telling another, before it is believed."""
    phone_ahead: float = 5.0
    """Radio and motion this far ahead of the cameras are not believed."""
    capacity: int = 20_000
    """Phones' messages held while no chunk closes."""


@dataclass(frozen=True)
class Closed:
    """A closed chunk and the names of what it holds, in the order of consumption."""

    chunk: Chunk
    consumed: tuple[str, ...]


@dataclass
class _Camera:
    last: float
    intervals: deque[float] = field(default_factory=lambda: deque(maxlen=16))

    def next_frame(self) -> float:
        """The earliest time at which this camera's next frame can come."""
        return self.last + (min(self.intervals) if self.intervals else 0.0)

    def usual_interval(self) -> float:
        """The median time between its frames; 0 where it is not known yet."""
        return sorted(self.intervals)[len(self.intervals) // 2] if self.intervals else 0.0


@dataclass
class _Doubt:
    """A run of frames of one camera whose time could not be believed."""

    first: float
    last: float
    count: int
    accepted: int
    """How many frames had been accepted, of any camera, when the run began."""
    gap: float
    """Seconds from the frame before, believed or not, to the last of the run; a slow camera repeats it."""


class Chunker:
    """Collects messages and closes chunks.

    Attributes:
        dropped: how many messages were dropped, by reason.
    """

    def __init__(self, settings: ChunkerSettings | None = None) -> None:
        self.settings = settings or ChunkerSettings()
        self.dropped: Counter[str] = Counter()
        self._cameras: dict[str, _Camera] = {}
        self._frames: list[tuple[DetectionFrame, str]] = []
        self._scans: _Waiting[RadioScan] = _Waiting()
        self._motions: _Waiting[MotionBatch] = _Waiting()
        self._erasures: list[tuple[Erasure, str]] = []
        self._models: list[tuple[RadioModelUpdate, str]] = []
        self._doubts: dict[str, _Doubt] = {}
        self._accepted = 0
        self._closed = -1
        """Number of the last chunk that may hold no more frames of its own."""

    @property
    def cameras(self) -> dict[str, float]:
        """The time of each camera's newest frame."""
        return {name: camera.last for name, camera in self._cameras.items()}

    @property
    def waiting(self) -> int:
        """How many frames wait for their chunk to close."""
        return len(self._frames)

    def resume_after(self, index: int) -> None:
        """Close no chunk up to ``index`` again: a tracker's state taken there is restored."""
        self._closed = max(self._closed, index)

    def add_scan(self, scan: RadioScan, name: str) -> None:
        """Take a radio scan; it leaves with the next chunk."""
        self._hold(self._scans, scan, name, "radio")

    def add_motion(self, motion: MotionBatch, name: str) -> None:
        """Take a motion batch; it leaves with the next chunk."""
        self._hold(self._motions, motion, name, "motion")

    def add_erasure(self, erasure: Erasure, name: str) -> None:
        """Take a withdrawal of consent; it leaves with the next chunk, whatever its time, and what waits does not."""
        self._erasures.append((erasure, name))
        self._scans.drop(erasure.device)
        self._motions.drop(erasure.device)

    def add_model(self, update: RadioModelUpdate, name: str) -> None:
        """Take a radio model that goes live with the next chunk; it takes the place of one that waits."""
        self._models = [(update, name)]

    def close_for_erasures(self) -> Closed | None:
        """Close the next chunk with the withdrawals that wait and nothing else: no camera's frame does it.

        None where nobody waits, or where no chunk was closed yet: then nobody knows anybody either.
        """
        if not self._erasures or self._closed < 0:
            return None
        self._closed += 1
        erasures, self._erasures = self._erasures, []
        period = self.settings.period
        chunk = Chunk(
            index=self._closed,
            t_start=self._closed * period,
            t_end=(self._closed + 1) * period,
            erasures=tuple(erasure for erasure, _ in erasures),
        )
        return Closed(chunk, tuple(name for _, name in erasures))

    def add_frame(self, frame: DetectionFrame, name: str) -> list[Closed]:
        """Take a camera's frame and return the chunks it closes, oldest first (usually none or one)."""
        reason = self._refusal(frame)
        if reason is not None:
            self.dropped[reason] += 1
            return []
        camera = self._cameras.get(frame.camera)
        if camera is None:
            self._cameras[frame.camera] = _Camera(frame.t)
        else:
            camera.intervals.append(frame.t - camera.last)
            camera.last = frame.t
        self._accepted += 1
        self._doubts.pop(frame.camera, None)
        self._frames.append((frame, name))
        return self._close()

    def _index(self, t: float) -> int:
        return math.floor(t / self.settings.period + 1e-6)

    def _newest(self) -> float:
        return max((camera.last for camera in self._cameras.values()), default=-math.inf)

    def _live(self) -> list[_Camera]:
        newest, s = self._newest(), self.settings
        return [
            camera
            for camera in self._cameras.values()
            if newest - camera.last <= max(s.silent, 3.0 * (camera.next_frame() - camera.last))
        ]

    def _refusal(self, frame: DetectionFrame) -> str | None:
        """Why the frame cannot be used, or None."""
        s = self.settings
        if not math.isfinite(frame.t):
            return "frame without a time"
        camera = self._cameras.get(frame.camera)
        if camera is not None and frame.t == camera.last:
            return "frame twice"
        known = max(self._newest(), (self._closed + 1) * s.period if self._closed >= 0 else -math.inf)
        if frame.t > known + self._stride(camera) and math.isfinite(known):
            reason = "frame from the far future"
        elif camera is not None and frame.t < camera.last:
            reason = "time went backwards"
        elif frame.t < known - s.oldest_frame and self._index(frame.t) <= self._closed:
            reason = "frame too late"
            if camera is not None or self._cameras:
                # Its own time goes on as ever, only behind the others': no clock was set.
                return reason
        else:
            return None
        if abs(frame.t - known) <= s.ahead:
            return reason  # it will have caught up soon
        return None if self._clock_was_set(frame) else reason

    def _clock_was_set(self, frame: DetectionFrame) -> bool:
        """Whether the cameras' time really jumped: several frames agree on it and no camera says otherwise."""
        camera, doubt = self._cameras.get(frame.camera), self._doubts.get(frame.camera)
        gap = frame.t - (doubt or camera or _Camera(frame.t)).last
        steady = doubt is not None and (
            0.0 < gap <= self._stride(camera) or (0.0 < 0.5 * doubt.gap <= gap <= 2.0 * doubt.gap)
        )
        if doubt is None or not steady or doubt.accepted != self._accepted:
            # Not a run yet, or somebody told another time meanwhile: whoever that was may be silent from now on.
            self._doubts[frame.camera] = _Doubt(frame.t, frame.t, 1, self._accepted, gap)
            return False
        before, doubt.last, doubt.gap, doubt.count = doubt.last, frame.t, gap, doubt.count + 1
        others = [other for name, other in self._cameras.items() if name != frame.camera]
        # Another camera had time enough to say otherwise.
        span = max((max(self.settings.silent, 3.0 * other.usual_interval()) for other in others), default=0.0)
        if doubt.count < self.settings.agree or doubt.last - doubt.first < span:
            return False
        if frame.t < (self._closed + 1) * self.settings.period:
            self.dropped["frame of the old time"] += len(self._frames)
            self._frames.clear()
            self._closed = -1
        self._cameras.clear()
        self._cameras[frame.camera] = _Camera(before)
        self._doubts.clear()
        return True

    def _stride(self, camera: _Camera | None) -> float:
        """How far ahead the next frame of a camera may be and still be believed, seconds."""
        return max(self.settings.ahead, 0.0 if camera is None else 2.0 * camera.usual_interval())

    def _hold(self, waiting: _Waiting[P], message: P, name: str, kind: str) -> None:
        if not math.isfinite(message.t):
            self.dropped[f"{kind} without a time"] += 1
            return
        if len(waiting) >= self.settings.capacity:
            waiting.pop_oldest()
            self.dropped[f"{kind} waiting for cameras"] += 1
        waiting.append((message, name))

    def _close(self) -> list[Closed]:
        s = self.settings
        closed: list[Closed] = []
        slack = 0.1 * s.period
        while self._frames:
            # The first chunk with frames; those that came late count to the one that is open.
            index = max(min(self._index(frame.t) for frame, _ in self._frames), self._closed + 1)
            end = (index + 1) * s.period
            if self._newest() < end + s.lateness and any(
                camera.next_frame() < end - slack and camera.last < end for camera in self._live()
            ):
                break
            closed.append(self._take(index, end))
            self._closed = index
        return closed

    def _take(self, index: int, end: float) -> Closed:
        mine = [entry for entry in self._frames if self._index(entry[0].t) <= index]
        self._frames = [entry for entry in self._frames if self._index(entry[0].t) > index]
        mine.sort(key=lambda entry: (entry[0].t, entry[0].camera))
        scans = self._phones(self._scans, "radio", end)
        motions = self._phones(self._motions, "motion", end)
        erasures, self._erasures = self._erasures, []
        models, self._models = self._models, []
        chunk = Chunk(
            index=index,
            t_start=index * self.settings.period,
            t_end=end,
            frames=tuple(frame for frame, _ in mine),
            scans=tuple(scan for scan, _ in scans),
            motions=tuple(motion for motion, _ in motions),
            erasures=tuple(erasure for erasure, _ in erasures),
            models=tuple(update for update, _ in models),
        )
        return Closed(chunk, tuple(name for entries in (mine, scans, motions, erasures, models) for _, name in entries))

    def _phones(self, waiting: _Waiting[P], kind: str, end: float) -> list[tuple[P, str]]:
        """Return the phones' messages that leave with the chunk that ends at ``end``."""
        leaving = []
        for message, name in waiting.take():
            if message.t < end - self.settings.oldest_phone:
                self.dropped[f"{kind} too old"] += 1
            elif message.t > end + self.settings.phone_ahead:
                self.dropped[f"{kind} from the far future"] += 1
            else:
                leaving.append((message, name))
        return leaving


class _Waiting(Generic[P]):
    """Messages in order of arrival."""

    def __init__(self) -> None:
        self._entries: deque[tuple[P, str]] = deque()

    def __len__(self) -> int:
        return len(self._entries)

    def append(self, entry: tuple[P, str]) -> None:
        self._entries.append(entry)

    def pop_oldest(self) -> None:
        self._entries.popleft()

    def drop(self, device: str) -> None:
        self._entries = deque(entry for entry in self._entries if entry[0].device != device)

    def take(self) -> list[tuple[P, str]]:
        entries = list(self._entries)
        self._entries.clear()
        return entries
