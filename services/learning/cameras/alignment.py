"""Was a camera knocked? Those that look at the same floor say so, and what to do about it.

Twice a minute each pair of cameras is asked which similarity brings the one's people onto the other's. A camera that
all its neighbours contradict, while they agree with others, was knocked: a correction is learned from the time it
happened on and proposed once it explains what came later. Where two cameras contradict each other, the plan may tell
which one is wrong; else both are doubtful and a person must look. A camera alone is watched by ``blocked_places``,
which notices and cannot mend.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, ClassVar, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from services.learning.cameras.blocked_places import BlockedPlaces, Walkable
from services.learning.cameras.camera_pairs import LEAST, LOOK_EVERY, CameraPairs, Pair, gain_of
from services.learning.cameras.registration import moved, register
from services.learning.proposal import Proposal
from services.learning.report_draft import ReportDraft
from services.learning.tracks.stretch import Stretch
from shared.learning_report import ModelKind
from shared.messages import CameraAlignment, DetectionFrame, Message

__all__ = ["AlignmentLessons", "AlignmentReading"]

Array = NDArray[np.float64]

TAUGHT = 90
"""Snapshots a correction is learned from, the latest."""
JUDGED = 10
"""Snapshots, newer than those that taught, that must judge it."""
MENDED = 0.4
"""Nats per detection that a correction must be worth: half a metre put right is worth 0.6, a chance find 0.15."""
FURTHEST, MOST_TURN, MOST_STRETCH = 3.0, math.radians(16.0), 0.3
"""Metres, radians and a share that a correction may amount to where people were seen, in the median."""


@dataclass(frozen=True)
class AlignmentReading:
    """What is known of where a camera looks, in the terms of ``CameraLessons``.

    Attributes:
        state: ``unknown`` where nobody can say.
        offset: metres by which its positions differ from what the others say.
        words: for an operator; empty where nothing is wrong.
    """

    state: Literal["unknown", "fine", "doubtful", "knocked", "corrected"] = "unknown"
    offset: float | None = None
    words: str = ""


class _State(msgspec.Struct):
    area: str
    active: dict[str, CameraAlignment]


class AlignmentLessons:
    """Watches the cameras of an area.

    Args:
        area: its id.
        walkable: whether a person can stand at each of (n, 2) places, such as ``FloorPlan.walkable`` of its floor.
        hangs: by camera, (x, y, z) metres, such as ``CameraGeometry.position``; turns of a camera it does not hold are
            mended where they amount to a shift, a turn and a stretch of the plan.
        calibrations: by camera, ``geometry_digest`` of the calibration that corrections are learned of.
    """

    kind: ClassVar[ModelKind] = "alignment"

    def __init__(
        self,
        area: str,
        walkable: Walkable,
        hangs: Mapping[str, Array] | None = None,
        calibrations: Mapping[str, str] | None = None,
    ) -> None:
        self._area = area
        self._pairs = CameraPairs()
        self._tried: dict[str, float] = {}
        self._active: dict[str, CameraAlignment] = {}
        self._hangs = dict(hangs or {})
        self._calibrations = dict(calibrations or {})
        self._blocked = BlockedPlaces(walkable)

    def take_frame(self, frame: DetectionFrame) -> None:
        """Take in what a camera saw, in order of time."""
        self._blocked.take_frame(frame)
        self._pairs.take(frame.camera, frame.t, np.column_stack([frame.x, frame.y]).reshape(-1, 2))

    def watch(self, message: Message) -> None:
        """Take in what a camera saw; the rest is left out."""
        if isinstance(message, DetectionFrame):
            self.take_frame(message)

    def tell(self, draft: ReportDraft) -> None:
        """Add where each camera is believed to look."""
        for camera in self.cameras:
            found = self.reading(camera)
            draft.camera(camera, self._area, alignment=found.state, offset=found.offset)
            draft.camera_words(camera, self._area, found.words)

    def learn(self, stretch: Stretch) -> None:
        """Take in nothing: what cameras see of everybody says more than what they see of who carries a phone."""

    def forget(self, device: str) -> None:
        """Forget a device: nothing is known of any."""

    def propose(self, now: float, until: float) -> Sequence[Proposal]:
        """Return corrections of cameras that were knocked, learned up to ``until`` and judged by what came after."""
        proposals = []
        for camera in self.cameras:
            witnesses, since = self._against(camera)
            newest = max((self._pairs.newest(camera, other) for other in witnesses), default=-math.inf)
            if not witnesses or newest < self._tried.get(camera, -math.inf) + LOOK_EVERY:
                continue
            self._tried[camera] = newest
            proposal = self._propose(camera, witnesses, since, now, until)
            if proposal is not None:
                proposals.append(proposal)
        return proposals

    def activated(self, model: Message) -> None:
        """Know the correction in use; what was seen before it is no evidence any more."""
        if not isinstance(model, CameraAlignment):
            return
        self._active[model.camera] = model
        self._blocked.restart(model.camera)
        self._pairs.forget(model.camera)

    def reading(self, camera: str) -> AlignmentReading:
        """Return what is known of a camera by now."""
        pairs = {other: self._pairs.said(camera, other) for other in self.cameras if other != camera}
        known = {other: pair for other, pair in pairs.items() if pair is not None}
        off = {other: pair for other, pair in known.items() if pair.off}
        if not off:
            alone = self._alone(camera)
            if alone is not None:
                return alone
            if not known:
                return AlignmentReading()
            return AlignmentReading("corrected" if self._corrected(camera) else "fine", _median(known), "")
        offset, since = _median(off), _clock(min(pair.since for pair in off.values()))
        others = ", ".join(sorted(off))
        witnesses, _ = self._against(camera)
        if witnesses:
            words = f"positions of camera {camera} have shifted by about {offset:.1f} m since {since}: was it knocked?"
            return AlignmentReading("knocked", offset, words)
        if any(self._against(other)[0] for other in off):
            return AlignmentReading("fine", None, "")  # it is the other one
        words = (
            f"positions of camera {camera} and of {others} differ by about {offset:.1f} m since {since}: one of "
            "them was knocked, look which"
        )
        return AlignmentReading("doubtful", offset, words)

    @property
    def cameras(self) -> list[str]:
        """Of which something was heard."""
        return self._pairs.cameras

    def state(self) -> dict[str, Any]:
        """Return the corrections in use; what cameras see now is known again within a minute."""
        state: dict[str, Any] = msgspec.to_builtins(_State(self._area, self._active))
        return state

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            ValueError: it is none, or another area's.
        """
        try:
            known = msgspec.convert(state, _State)
        except msgspec.ValidationError as error:
            raise ValueError(f"alignment lessons: {error}") from error
        if known.area != self._area:
            raise ValueError(f"alignment lessons: area: {known.area!r}; allowed: {self._area!r}")
        self._active = known.active

    def _alone(self, camera: str) -> AlignmentReading | None:
        """Return what the plan says against a camera that no other contradicts."""
        blocked = self._blocked.reading(camera)
        if blocked is None:
            return None
        where = f"{100.0 * blocked.share:.0f} % of the people camera {camera} sees stand where nobody can"
        if blocked.usual is None:
            return AlignmentReading("doubtful", None, f"{where}: are its calibration and the floor's plan right?")
        where += f", before {100.0 * blocked.usual:.1f} %"
        return AlignmentReading("knocked", None, f"since {_clock(blocked.since)} {where}: was it knocked?")

    def _corrected(self, camera: str) -> bool:
        active = self._active.get(camera)
        return active is not None and not np.allclose(active.homography, np.eye(3).ravel())

    def _against(self, camera: str) -> tuple[list[str], float]:
        """Return the cameras that contradict this one and are in the right, and since when.

        They are where others bear them out, or the plan does: this one's people stand where nobody can, theirs do not.
        Nobody is, where one that looks at the same floor agrees with this one.
        """
        impossible = self._blocked.reading(camera) is not None
        off: list[str] = []
        since = math.inf
        for other in self.cameras:
            pair = self._pairs.said(camera, other) if other != camera else None
            if pair is None:
                continue
            if not pair.off:
                return [], math.inf
            others = (self._pairs.said(other, third) for third in self.cameras if third not in (camera, other))
            borne_out = any(third is not None and not third.off for third in others)
            if borne_out or (impossible and self._blocked.reading(other) is None):
                off.append(other)
                since = min(since, pair.since)
        return off, since

    def _propose(
        self, camera: str, witnesses: Sequence[str], since: float, now: float, until: float
    ) -> Proposal | None:
        seen = list(itertools.chain(*(self._pairs.of(camera, other) for other in witnesses)))
        seen = sorted((one for one in seen if one.t >= since), key=lambda one: one.t)
        taught = [one for one in seen if one.t <= until][-TAUGHT * len(witnesses) :]
        judges = [one for one in seen if one.t > until]
        found = register(taught, self._hangs.get(camera)) if len(taught) >= LEAST else None
        if found is None or len(judges) < JUDGED:
            return None
        places = np.concatenate([one.ours for one in taught])
        if not _allowed(found, places):
            return None
        mean, margin = gain_of(judges, found)
        margin = max(margin, MENDED)
        if mean <= margin:
            return None
        active = self._active.get(camera)
        before = np.eye(3) if active is None else np.reshape(active.homography, (3, 3))
        offset = float(np.linalg.norm(moved(found, places) - places, axis=1).mean())
        reason = f"positions have shifted by about {offset:.1f} m since {_clock(since)}, say {', '.join(witnesses)}"
        a, b, c, d, e, f, g, h, i = (float(value) for value in (found @ before).ravel())
        homography = (a, b, c, d, e, f, g, h, i)
        return Proposal(
            kind=self.kind,
            subject=camera,
            area=self._area,
            model=CameraAlignment(
                t=now,
                camera=camera,
                version=0,
                homography=homography,
                reason=reason,
                geometry=self._calibrations.get(camera, ""),
            ),
            trained_until=until,
            gain=mean,
            margin=margin,
            evidence={
                "offset": offset,
                "detections": float(len(places)),
                "turn": math.atan2(found[1, 0], found[0, 0]),
                "since": since,
            },
            reason=reason,
        )


def _allowed(found: Array, places: Array) -> bool:
    """Whether a correction is no more than a knock, by how far it shifts, turns and stretches."""
    there = moved(found, places)
    across, up = (moved(found, places + step) - there for step in (np.array([0.01, 0.0]), np.array([0.0, 0.01])))
    turn = np.arctan2(across[:, 1] - up[:, 0], across[:, 0] + up[:, 1])
    stretch = 0.5 * np.abs(np.log(np.abs(across[:, 0] * up[:, 1] - across[:, 1] * up[:, 0]) / 1e-4))
    shift = np.linalg.norm(there - places, axis=1)
    return bool(
        np.median(shift) <= FURTHEST
        and np.abs(np.median(turn)) <= MOST_TURN
        and np.median(stretch) <= math.log1p(MOST_STRETCH)
    )


def _median(pairs: Mapping[str, Pair]) -> float:
    return float(np.median([pair.offset for pair in pairs.values()]))


def _clock(t: float) -> str:
    return datetime.fromtimestamp(t, UTC).strftime("%H:%M UTC")
