"""One area's stretches: assembled as its messages come, and judged."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from typing import Any, Protocol, runtime_checkable

from services.learning.lesson import Watching
from services.learning.report_draft import ReportDraft, Telling
from services.learning.tracks.assembler import StretchAssembler
from services.learning.tracks.stretch import Stretch
from services.learning.tracks.verdict import Verdict
from shared.erased import Erased
from shared.messages import CameraStatus, DetectionFrame, Message, MotionBatch, RadioScan, Revision, TrackFrame

__all__ = ["AreaTracks", "Following", "Forgetting", "Judge", "Keeping", "Sight"]

Judge = Callable[[Stretch], Verdict]


class Sight(Protocol):
    """What cameras said for each track: nats, detection by detection."""

    def take(self, frame: DetectionFrame) -> None:
        """Take in what one camera saw."""
        ...

    def score(self, frame: TrackFrame) -> Mapping[int, float]:
        """Return the nats by which cameras spoke for each track of a frame since the frame before."""
        ...


@runtime_checkable
class Forgetting(Protocol):
    """A judge or sight that knows phones one by one; none has to."""

    def forget(self, device: str) -> None:
        """Forget a phone whose owner withdrew consent."""
        ...


@runtime_checkable
class Following(Protocol):
    """A judge that judges under the live radio model; none has to."""

    def activated(self, model: Message) -> None:
        """A radio model of the area went live."""
        ...


@runtime_checkable
class Keeping(Protocol):
    """A judge that knows something worth keeping over a restart; none has to."""

    def state(self) -> dict[str, Any]:
        """Return all it knows, as what ``msgspec.json`` encodes."""
        ...

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            ValueError: it is no such state.
        """
        ...


class AreaTracks:
    """One area.

    Args:
        area: its id.
        cameras: whose detections are its own.
        assembler: makes stretches.
        judge: says whether one may teach.
        sight: scores tracks by detections; None: nobody asks for it.
        anew: makes it as it was before any message came.
    """

    def __init__(
        self,
        area: str,
        cameras: Collection[str],
        assembler: StretchAssembler,
        judge: Judge,
        sight: Sight | None,
        anew: Callable[[], AreaTracks],
    ) -> None:
        self.area = area
        self.anew = anew
        self.t = -math.inf
        """Of the newest frame: the sensors' time."""
        self.taught = -math.inf
        """When the last good stretch ended."""
        self._cameras = frozenset(cameras)
        self._assembler = assembler
        self._judge = judge
        # Asked once: it is much slower than what is asked then, for every message.
        self._watching = judge if isinstance(judge, Watching) else None
        self._sight = sight

    def take(self, message: Message, erased: Erased) -> bool:
        """Take in a message if it is of this area; whether it is."""
        match message:
            case TrackFrame() if message.area == self.area:
                frame = erased.from_tracks(message)
                self._watch(frame)
                self._assembler.take_frame(frame, None if self._sight is None else self._sight.score(frame))
                self.t = frame.t
            case Revision() if message.area == self.area:
                self._assembler.take_revision(erased.from_revision(message))
            case DetectionFrame() if message.camera in self._cameras:
                if self._sight is not None:
                    self._sight.take(message)
            case RadioScan():
                self._watch(message)
                self._assembler.take_scan(message)
            case MotionBatch():
                self._watch(message)
                self._assembler.take_motion(message)
            case CameraStatus() if message.camera in self._cameras:
                pass  # for learners that watch
            case _:
                return False
        return True

    def _watch(self, message: Message) -> None:
        if self._watching is not None:
            self._watching.watch(message)

    def close(self) -> list[tuple[Stretch, Verdict]]:
        """Return the stretches that ended and may teach, also those that are in doubt, in order of device and time."""
        may_teach = []
        for stretch in self._assembler.close():
            verdict = self._judge(stretch)
            if verdict.good:
                self.taught = max(self.taught, float(stretch.t[-1]))
            if verdict.good or verdict.doubtful:
                may_teach.append((stretch, verdict))
        return may_teach

    def forget(self, device: str) -> None:
        """Forget a device whose owner withdrew consent."""
        self._assembler.forget(device)
        for part in (self._judge, self._sight):
            if isinstance(part, Forgetting):
                part.forget(device)

    def activated(self, model: Message) -> None:
        """Judge under a radio model of this area from now on."""
        if isinstance(self._judge, Following):
            self._judge.activated(model)

    def state(self) -> dict[str, Any]:
        """Return what its judge knows, for a restart; empty where that keeps nothing."""
        return self._judge.state() if isinstance(self._judge, Keeping) else {}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            ValueError: it is no such state.
        """
        if isinstance(self._judge, Keeping) and state:
            self._judge.restore(state)

    def tell(self, draft: ReportDraft) -> None:
        """Add to the report what judge and sight tell: how many stretches were good, and why the others were not."""
        for part in (self._judge, self._sight):
            if isinstance(part, Telling):
                part.tell(draft)
