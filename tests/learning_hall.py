"""Some minutes of a small hall as learning hears it: people with phones, tracks that bear their names, two cameras.

Tracks are told as a tracker would that is nearly right, so that a test can swap, invent or silence what it likes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from fusion_world import frame
from learning_models import area_judged_by
from numpy.typing import NDArray
from radio_stretches import hall_of

from services.fusion.area_view import AreaView
from services.fusion.chunks import Chunker, ChunkerSettings
from services.fusion.rescore.worker import rescore
from services.fusion.tracker import Chunk
from services.learning.activation.database import in_memory
from services.learning.activation.gate import Gate
from services.learning.activation.store import ModelStore
from services.learning.area_tracks import Judge
from services.learning.learners import Tools, areas_of, lessons_of
from services.learning.loop import LearningLoop
from services.learning.trials import Inline, Pace
from shared.messages import DetectionFrame, Message, MotionBatch, RadioScan, TrackFrame
from shared.site import Site

__all__ = ["T0", "Change", "Hall", "Run", "learn", "with_radio_of"]

Array = NDArray[np.float64]

T0 = 1_700_000_000.0
RATE = 3
"""Frames a second."""
HELD_OUT = 100.0
BUSY: Mapping[str, Any] = {"error": "busy: another candidate is being tried; ask again later"}
POINTS = 6
Told = DetectionFrame | RadioScan | MotionBatch
Change = Callable[[Message], Message | None]
"""What becomes of a message; None: it is never sent."""


@dataclass
class Hall:
    """What everybody did; person ``k`` carries phone ``phone-k`` if ``k`` is below ``phones``.

    Attributes:
        paths: (people, seconds x RATE, 2) metres.
    """

    site: Site
    people: int = 4
    phones: int = 4
    seconds: int = 225
    still: bool = False
    seed: int = 1
    paths: Array = field(init=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        self._radio = hall_of(self.site, self.seed)
        self.paths = np.stack([self._path() for _ in range(self.people)])

    def messages(self) -> list[Message]:
        """Return everything in the order in which learning hears it: phones half a second late."""
        told: list[tuple[float, int, Message]] = []
        for row in range(self.seconds * RATE):
            t = T0 + row / RATE
            told += [(t, 0, self._detections(row, t, camera)) for camera in ("west", "east")]
            told.append((t + 0.01, 1, self._tracks(row, t)))
        for person in range(self.phones):
            told += [(scan.t + 0.5, 2, scan) for scan in self._scans(person)]
            told += [(batch.t + 0.5, 3, batch) for batch in self._motions(person)]
        return [message for _, _, message in sorted(told, key=lambda row: row[:2])]

    def _path(self) -> Array:
        place = self._rng.uniform((2.0, 2.0), (22.0, 12.0))
        if self.still:
            return np.repeat(place[None], self.seconds * RATE, axis=0)
        path, goal, rest = [], place, 0.0
        for _ in range(self.seconds * RATE):
            away = float(np.hypot(*(goal - place)))
            if away < 0.4:
                goal, rest = self._rng.uniform((1.0, 1.0), (23.0, 13.0)), self._rng.uniform(0.0, 4.0)
            rest -= 1.0 / RATE
            if rest <= 0.0:
                place = place + 1.2 / RATE * (goal - place) / max(away, 1.2 / RATE)
            path.append(place)
        return np.array(path)

    def _detections(self, row: int, t: float, camera: str) -> DetectionFrame:
        seen = self.paths[:, row][self._rng.random(self.people) < 0.95]
        return frame(t, seen + self._rng.normal(0.0, 0.1, seen.shape), camera, row, sigma=0.1)

    def _tracks(self, row: int, t: float) -> TrackFrame:
        place = self.paths[:, row] + self._rng.normal(0.0, 0.05, (self.people, 2))
        pace = (self.paths[:, row] - self.paths[:, max(row - 1, 0)]) * RATE
        count, named = self.people, [f"phone-{k}" if k < self.phones else None for k in range(self.people)]
        return TrackFrame(
            t=t, area="hall", chunk=row, tracker="evidence", track=list(range(1, count + 1)), floor=["ground"] * count,
            x=place[:, 0].tolist(), y=place[:, 1].tolist(), covariance=[(0.01, 0.0, 0.01)] * count,
            vx=pace[:, 0].tolist(), vy=pace[:, 1].tolist(), state=["confirmed"] * count, device=named,
            probability=[0.95 if name else 0.0 for name in named], runner_up=[None] * count,
            runner_up_probability=[0.0] * count, former=[[]] * count, sources=[["west", "east"]] * count,
            quality=[0.9] * count,
        )  # fmt: skip

    def _scans(self, person: int) -> list[RadioScan]:
        level = self._radio.level(self.paths[person, ::RATE]) + self._rng.normal(0.0, 2.0)
        walked = np.concatenate([[0.0], np.hypot(*np.diff(self.paths[person, ::RATE], axis=0).T)])
        shade, scans = self._rng.normal(0.0, 2.5, POINTS), []
        for second in range(self.seconds):
            kept = math.exp(-walked[second] / 3.0 - 1.0 / 20.0)
            shade = kept * shade + math.sqrt(1.0 - kept**2) * self._rng.normal(0.0, 2.5, POINTS)
            heard = np.round(level[second] + shade + self._rng.normal(0.0, 2.0, POINTS))
            scans.append(
                RadioScan(
                    t=T0 + second, device=f"phone-{person}", seq=second, rssi=heard.tolist(),
                    access_point=[f"ap-{number}" for number in range(1, POINTS + 1)],
                )
            )  # fmt: skip
        return scans

    def _motions(self, person: int) -> list[MotionBatch]:
        made = []
        for second in range(self.seconds - 1):
            start, way = T0 + second, self.paths[person, (second + 1) * RATE] - self.paths[person, second * RATE]
            steps = 2 if np.hypot(*way) > 0.6 else 0
            heading = (math.atan2(way[1], way[0]) + self._rng.normal(0.1, 0.1, steps)).tolist()
            made.append(
                MotionBatch(
                    t=start + 1.0, t_start=start, device=f"phone-{person}", seq=second,
                    activity="walking" if steps else "still", step_t=[start + 0.27, start + 0.77][:steps],
                    length=[float(np.hypot(*way)) / 2.0] * steps, length_variance=[0.01] * steps, heading=heading,
                    heading_variance=[0.05] * steps,
                )
            )  # fmt: skip
        return made


@dataclass
class Run:
    """What came of it: the loop, the questions fusion was asked with its answers, and what went live."""

    loop: LearningLoop
    asked: list[Mapping[str, Any]]
    live: list[Message]
    end: float

    def refused(self) -> dict[str, int]:
        """Return why stretches did not teach, and how often."""
        return self.loop.report(self.end).areas[0].tracks.refused

    def teachers(self) -> set[str]:
        """Return the phones that taught the radio."""
        [radio] = [lesson.learner for lesson in self.loop.lessons if lesson.name == "radio/hall"]
        return set(radio._evidence.devices)  # type: ignore[attr-defined]

    def reasons(self, kind: str) -> list[str]:
        """Return what the history says of models of a kind, oldest first."""
        return [f"{said.decision}: {said.reason}" for said in reversed(self.loop.store.history()) if said.kind == kind]


def learn(
    site: Site,
    messages: Sequence[Message],
    change: Change = lambda message: message,
    *,
    tried: bool = False,
    redetect: Callable[[str, Mapping[str, float]], Mapping[str, Any]] = lambda *_: {"error": "no pictures are kept"},
    judge: Judge | None = None,
) -> Run:
    """Feed all of learning, every learner in its place, what was said.

    Args:
        site: the hall's.
        messages: in order.
        change: what becomes of each.
        tried: whether fusion's own ``rescore`` tries candidates, once there is enough to try them on; else fusion is
            busy all the time.
        redetect: what cameras answer.
        judge: of stretches, in the place of the area's own.
    """
    view = AreaView.of(site, "hall")
    asked: list[Mapping[str, Any]] = []
    live: list[Message] = []
    chunks: list[Chunk] = []

    def ask(_: str, question: bytes) -> Mapping[str, Any]:
        recent = [chunk for chunk in chunks if chunk.t_end > t - HELD_OUT - 60.0]
        asked.append(rescore(question, recent, view) if tried else BUSY)
        return asked[-1]

    flat = {"sight": {"candidate": 0.0, "gain_error": 0.1}}  # whatever the options
    tools = Tools(redetect, lambda *_: flat, Inline(), lambda _: None)
    areas = areas_of(site, ["hall"])
    if judge is not None:
        points = [point.id for point in site.access_points if point.floor == "ground"]
        areas = {"hall": area_judged_by(judge, points=points, cameras=["west", "east"])}
    store, pace = ModelStore(in_memory()), Pace(propose=30.0, held_out=HELD_OUT)
    loop = LearningLoop(areas, lessons_of(site, ["hall"], tools), Gate(), store, ask, live.append, pace)
    loop.begin()
    chunker, t = Chunker(ChunkerSettings()), T0
    looked = T0 + 200.0 if tried else T0
    for number, message in enumerate(filter(None, map(change, messages))):
        loop.take(message)
        match message:
            case DetectionFrame():
                chunks += [closed.chunk for closed in chunker.add_frame(message, str(number))]
            case RadioScan():
                chunker.add_scan(message, str(number))
            case MotionBatch():
                chunker.add_motion(message, str(number))
        t = max(t, message.t)
        if t >= looked + 5.0:
            looked = t
            loop.look(t)
    return Run(loop, asked, live, t)


def with_radio_of(swap: Mapping[str, str]) -> Change:
    """Let some phones tell what others heard: ``swap`` says by the one that heard it, which one tells it."""

    def changed(message: Message) -> Message:
        if isinstance(message, RadioScan) and message.device in swap:
            return msgspec.structs.replace(message, device=swap[message.device])
        return message

    return changed
