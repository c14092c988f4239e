"""All learners of a site, called one by one so that none can harm another."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import structlog

from services.learning.activation.kinds import kind_of, read_model, subject_of
from services.learning.activation.rows import StoredModel
from services.learning.area_tracks import AreaTracks
from services.learning.faults import Faults
from services.learning.lesson import Alert, Critic, Lesson, MapKeeping, Personal, Watching, Weighing
from services.learning.proposal import Learner, Proposal
from services.learning.report_draft import ReportDraft, Telling
from shared.erased import Erased
from shared.learning_command import LearningAnswer, LearningCommand
from shared.learning_report import ModelKind
from shared.messages import (
    CameraStatus,
    DetectionFrame,
    Message,
    MotionBatch,
    RadioScan,
    Revision,
    TrackFrame,
    encode,
)

__all__ = ["Lessons"]

log = structlog.get_logger(__name__)

TAKE: dict[type[Message], str] = {
    TrackFrame: "take in tracks",
    Revision: "take in revised tracks",
    DetectionFrame: "take in detections",
    CameraStatus: "take in what a camera says of itself",
    RadioScan: "take in radio",
    MotionBatch: "take in steps",
}
LEARN = "learn from a walk"
ADOPT = "take in a live model"

Part = AreaTracks | Learner
"""What has a name, is told what goes live, knows something worth keeping and can forget."""


class Lessons:
    """Who learns and where stretches come from. Used by one thread.

    Nothing here raises because a learner or an area does: that is told (``troubles``), and the call that raised rests
    (``Faults``). Who could not forget a phone is made anew from nothing.

    Args:
        areas: where stretches come from, by area.
        lessons: the learners in their places.
    """

    def __init__(self, areas: Mapping[str, AreaTracks], lessons: Sequence[Lesson]) -> None:
        self.areas = dict(areas)
        self._lessons = {lesson.name: lesson for lesson in lessons}
        self._faults = Faults()
        self._uninformed: set[str] = set()
        """Who does not know what is live: made anew, or raised when told. Proposes nothing until it does."""
        self._call_roll()

    def __iter__(self) -> Iterator[Lesson]:
        """Return the lessons in order."""
        return iter(self._lessons.values())

    def _call_roll(self) -> None:
        self._tracks = [(f"tracks/{name}", area) for name, area in self.areas.items()]
        # Asked once: it is much slower than what is asked then, for every message.
        self._watching = [(one, one.learner.watch) for one in self if isinstance(one.learner, Watching)]

    # -- what they are told ------------------------------------------------------------------------------------------

    def take(self, message: Message, erased: Erased) -> None:
        """Tell a message to the areas it is of, and to who watches there."""
        what = TAKE.get(type(message), "take in a message")
        of = {area.area for name, area in self._tracks if self._faults.call(name, what, area.take, message, erased)}
        if of:
            for lesson, watch in self._watching:
                if not of.isdisjoint(lesson.areas):
                    self._faults.call(lesson.name, what, watch, message)

    def teach(self) -> None:
        """Tell the stretches that ended."""
        for name, area in self._tracks:
            for stretch, verdict in self._faults.call(name, "judge walks", area.close) or ():
                for lesson in self:
                    if area.area not in lesson.areas:
                        continue
                    if verdict.good:
                        self._faults.call(lesson.name, LEARN, lesson.learner.learn, stretch)
                    elif isinstance(lesson.learner, Weighing):
                        self._faults.call(lesson.name, LEARN, lesson.learner.learn_doubtful, stretch)

    def forget(self, device: str) -> None:
        """Forget a phone whose owner withdrew consent; what cannot forget it alone forgets all."""
        for name, part in self._parts():
            if not self._faults.done(name, "forget a phone, and knows nothing any more", part.forget, device):
                self._make_anew(name)

    def judge_under(self, model: StoredModel) -> None:
        """Have stretches judged under a radio model that went live."""
        for name, part in self._concerned(model):
            if isinstance(part, AreaTracks):
                self._adopt(name, part, model)

    def activated(self, model: StoredModel) -> None:
        """Tell a model that went live to all whom it concerns."""
        for name, part in self._concerned(model):
            self._adopt(name, part, model)

    def inform(self, live: Callable[[], Sequence[StoredModel]]) -> None:
        """Tell the live models to who does not know them."""
        due = {name for name in self._uninformed if not self._faults.rests(name, ADOPT)}
        models = live() if due else ()
        self._uninformed -= due
        for model in models:
            for name, part in self._concerned(model):
                if name in due:
                    self._adopt(name, part, model)

    def _concerned(self, model: StoredModel) -> list[tuple[str, Part]]:
        judges: list[tuple[str, Part]] = [
            (name, area) for name, area in self._tracks if model.kind == "radio" and area.area == model.area
        ]
        learners = [one for one in self if one.learner.kind == model.kind and model.area in one.areas]
        return judges + [(one.name, one.learner) for one in learners]

    def _adopt(self, name: str, part: Part, model: StoredModel) -> None:
        if not self._faults.done(name, ADOPT, part.activated, model.model):
            self._uninformed.add(name)

    def _make_anew(self, name: str) -> None:
        if name in self._lessons:
            lesson = self._lessons[name]
            self._lessons[name] = replace(lesson, learner=lesson.anew())
        else:
            former = dict(self._tracks)[name]
            area = self.areas[former.area] = former.anew()
            area.t, area.taught = former.t, former.taught
        self._uninformed.add(name)
        self._call_roll()

    # -- what they say -----------------------------------------------------------------------------------------------

    def alarms(self) -> list[Proposal]:
        """Return urgent candidates."""
        found: list[Proposal] = []
        for lesson, t in self._informed():
            if isinstance(lesson.learner, Alert):
                found += self._faults.call(lesson.name, "look for changes", _storable, lesson.learner.alarms, t) or ()
        return found

    def proposals(self, held_out: float) -> list[Proposal]:
        """Return candidates taught by nothing that is newer than ``held_out`` seconds."""
        found: list[Proposal] = []
        for lesson, t in self._informed():
            found += (
                self._faults.call(lesson.name, "propose models", _storable, lesson.learner.propose, t, t - held_out)
                or ()
            )
        return found

    def _informed(self) -> list[tuple[Lesson, float]]:
        """Return who may propose, with the newest time of the sensors there."""
        newest = [
            (one, max((self.areas[name].t for name in one.areas if name in self.areas), default=-math.inf))
            for one in self
        ]
        return [(one, t) for one, t in newest if math.isfinite(t) and one.name not in self._uninformed]

    def critics(self, kind: ModelKind) -> list[str]:
        """Return the names of those who can tell whether a model of this kind should have gone live."""
        return [one.name for one in self if one.learner.kind == kind and isinstance(one.learner, Critic)]

    def regret(self, critic: str, former: Message, since: float) -> tuple[float, float] | None:
        """Ask a critic; see there."""
        learner = self._lessons[critic].learner
        if critic in self._uninformed or not isinstance(learner, Critic):
            return None
        return self._faults.call(critic, "judge a live model", learner.regret, former, since)

    def tell(self, draft: ReportDraft) -> None:
        """Add to the report what each knows."""
        for name, area in self._tracks:
            self._faults.call(name, "report", area.tell, draft)
        for lesson in self:
            if isinstance(lesson.learner, Telling):
                self._faults.call(lesson.name, "report", lesson.learner.tell, draft)

    def map(self, command: LearningCommand) -> LearningAnswer | None:
        """Return a map that is learned in the area of an order; None: nobody learns it."""
        for lesson in self:
            if isinstance(lesson.learner, MapKeeping) and command.area in lesson.areas:
                answer = self._faults.call(lesson.name, "draw a map", lesson.learner.map, command)
                if answer is not None:
                    return answer
        return None

    # -- what they know ----------------------------------------------------------------------------------------------

    def states(self) -> tuple[dict[str, bytes], list[str]]:
        """Return by name what all know, and the names of those who could not tell."""
        told: dict[str, bytes] = {}

        def tell(name: str, part: Part) -> None:
            told[name] = msgspec.json.encode(part.state(), enc_hook=_plain)

        for name, part in self._parts():
            self._faults.done(name, "save what it knows", tell, name, part)
        return told, [name for name, _ in self._parts() if name not in told]

    def restore(self, states: Mapping[str, bytes], aside: Mapping[str, bytes]) -> dict[str, bool]:
        """Have all go on from what they knew, or from what was set aside before, where they understand that alone.

        Returns:
            By name of who did not understand what it knew whether it goes on from what was set aside; else it begins
            anew.
        """
        not_understood = {}
        for name in self.names:
            known = name in states or name in aside
            if known and not (name in states and self._restore(name, states[name])):
                not_understood[name] = name in aside and self._restore(name, aside[name])
        return not_understood

    def _restore(self, name: str, state: bytes) -> bool:
        """Whether who has a name goes on from a state; else it is as before, or made anew."""
        part, refused = dict(self._parts())[name], []

        def restore() -> None:
            try:
                part.restore(msgspec.json.decode(state))
            except ValueError as error:
                log.warning("what was learned is not understood, it is set aside", part=name, reason=str(error))
                refused.append(name)

        if not self._faults.done(name, "read what it knew", restore):
            self._make_anew(name)
            return False
        return not refused

    def devices(self) -> set[str]:
        """Return the phones known one by one to learners that tell."""
        known: set[str] = set()
        for lesson in self:
            if isinstance(lesson.learner, Personal):
                known.update(self._faults.call(lesson.name, "name its phones", _devices, lesson.learner) or ())
        return known

    @property
    def names(self) -> list[str]:
        """Under which names it is kept what all know."""
        return [name for name, _ in self._parts()]

    def _parts(self) -> list[tuple[str, Part]]:
        """Return by name all that knows something worth keeping."""
        return [*self._tracks, *((one.name, one.learner) for one in self)]

    # -- what is wrong with them -------------------------------------------------------------------------------------

    def look(self, now: float) -> None:
        """Go on to ``now``: who rested may be called again."""
        self._faults.look(now)

    def troubles(self) -> dict[str, tuple[frozenset[str], str]]:
        """Return by name of who failed lately its areas, and in plain words what it could not do."""
        areas = {name: frozenset({area.area}) for name, area in self._tracks} | {one.name: one.areas for one in self}
        return {name: (areas[name], f"lesson {name} {words}") for name, words in self._faults.words().items()}


def _storable(ask: Callable[..., Sequence[Proposal]], *arguments: float) -> list[Proposal]:
    """Return the proposals that are what they say.

    Raises:
        Exception: one cannot be told on the bus, or not be read again: this is its learner's error, as any other.
    """
    sound = []
    for one in ask(*arguments):
        read_model(one.kind, encode(one.model))
        if (kind_of(one.model), subject_of(one.model)) == (one.kind, one.subject):
            sound.append(one)
        else:
            log.error("a proposal is not what it says", kind=one.kind, subject=one.subject)
    return sound


def _devices(learner: Personal) -> Collection[str]:
    return learner.devices


def _plain(value: Any) -> Any:
    """Return a number or an array of NumPy's, which slip into states, as JSON can hold it."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise NotImplementedError(f"a state holds {type(value).__name__}; allowed: what JSON can hold")
