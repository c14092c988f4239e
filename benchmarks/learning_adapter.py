"""The learners of ``services/learning`` as experiments take them: from a run to models, without bus, clock and truth.

The one place where experiments meet them.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.fusion_run import FusionRun, chunks_of
from benchmarks.world_record import WorldRecord
from services.fusion.area_view import AreaView
from services.fusion.chunks import period_of
from services.fusion.registry import make_tracker
from services.fusion.rescore.sight import SightJudge
from services.fusion.rescore.trial import WARM_UP
from services.fusion.rescore.worker import rescore
from services.fusion.tracker import Chunk
from services.fusion.trained_view import under_model
from services.learning.activation.answer import Trial, read_answer
from services.learning.activation.database import in_memory
from services.learning.activation.gate import Gate, Ruling
from services.learning.activation.questions import held_out, question_of
from services.learning.activation.store import ModelStore
from services.learning.cameras.detector_choice import Sweep, choose_detector
from services.learning.learners import Tools, areas_of, lessons_of
from services.learning.loop import LearningLoop
from services.learning.proposal import Proposal
from services.learning.radio.lessons import RadioLessons
from services.learning.tracks.stretch import Stretch
from services.learning.trials import Inline, Pace
from services.learning.walking.stride_lessons import StrideLessons
from shared.learning_report import Activation
from shared.messages import Message, RadioModelUpdate, StrideModel, TrackFrame
from shared.radio import RadioModel, ShadowingMap, pack_radio_model
from shared.site import Site
from shared.walking.stride import StrideLine

__all__ = [
    "RECENT",
    "Teacher",
    "chosen_rate",
    "learned_radio",
    "learned_strides",
    "ruling_on",
    "run_with_score",
]

RECENT = 300.0
"""Seconds of chunks that fusion keeps for trials, by default."""


def run_with_score(record: WorldRecord, tracker: str, view: AreaView) -> tuple[FusionRun, float]:
    """Return a run over a record, and the cumulative quality score of its detections, nats per second.

    As fusion reckons it for a camera that asks; but no scan is withheld from the tracker, so that errors can be read
    from the same run.
    """
    machine = make_tracker(tracker, view)
    chunks = list(chunks_of(record, period_of(machine.cycle)))
    since, until = chunks[0].t_start + WARM_UP, chunks[-1].t_end
    judge = SightJudge(view, since, until)
    frames: list[TrackFrame] = []
    for chunk in chunks:
        if frames:
            judge.look(chunk.frames, frames[-1])
        frames.append(machine.step(chunk))
    return FusionRun(frames, [], []), judge.sight().quality / (until - since)


def chosen_rate(rates: Sequence[float], scores: Sequence[float], active: float) -> int:
    """Return the place of the rate that the detector's own choice comes nearest to.

    Args:
        rates: ascending; ``active`` is one of them.
        scores: of each.
        active: the rate in use.
    """

    def redetect(options: Mapping[str, float]) -> Mapping[str, float]:
        """Between two rates that were tried, the score is taken to lie on the line between them."""
        return {"cqs": float(np.interp(math.log(options["learning_rate"]), np.log(rates), scores))}

    def scored(told: Mapping[str, float], best: Mapping[str, float]) -> Mapping[str, float]:
        return told

    found = choose_detector({"learning_rate": active}, redetect, scored, (Sweep("learning_rate", rates),))
    value = found.options.get("learning_rate", active)
    return int(np.argmin(np.abs(np.log(np.array(rates) / value))))


def learned_radio(
    stretches: Iterable[Stretch], site: Site, view: AreaView, doubtful: Iterable[Stretch] = ()
) -> AreaView:
    """Return the view with the radio that stretches, also ``doubtful`` ones, teach; as it was if that is too little."""
    lessons = RadioLessons(site, view.area)
    end = -math.inf
    taken = [(stretch, lessons.learn) for stretch in stretches]
    taken += [(stretch, lessons.learn_doubtful) for stretch in doubtful]
    for stretch, take in sorted(taken, key=lambda pair: float(pair[0].t[-1])):
        take(stretch)
        end = max(end, float(stretch.t[-1]))
    for proposal in lessons.propose(end, end):
        if isinstance(proposal.model, RadioModelUpdate):
            return under_model(view, proposal.model.model)
    return view


def learned_strides(stretches: Iterable[Stretch], area: str) -> Mapping[str, StrideLine]:
    """Return the line of each device whose stretches prove it on each other."""
    lessons = StrideLessons(area)
    end = -math.inf
    for stretch in stretches:
        lessons.learn(stretch)
        end = max(end, float(stretch.t[-1]))
    lines = {}
    for proposal in lessons.propose(end, end):
        if isinstance(proposal.model, StrideModel):
            line = proposal.model
            lines[line.device] = StrideLine(np.array(line.slope), np.array(line.offset), np.array(line.scale_variance))
    return lines


def ruling_on(
    looks: Iterable[tuple[WorldRecord, float]], tracker: str, active: AreaView, candidate: AreaView
) -> Ruling:
    """Return what the gate says of a candidate for an area's radio.

    Args:
        looks: at least one record, and the time, seconds since the epoch, from which on it judges: nothing after that
            taught either model. The next is looked at only where the gate wants more.
        tracker: name of the tracker that runs.
        active: the area with the radio that is live.
        candidate: the area with the candidate's.
    """
    question = question_of(RadioModelUpdate(t=0.0, area=active.area, version=1, model=_file(candidate))) or b""
    trials: list[Trial] = []
    for record, since in looks:
        chunks = list(chunks_of(record, period_of(make_tracker(tracker, active).cycle)))
        trials.append(read_answer(rescore(held_out(question, since), chunks, active, tracker)))
        proposal = Proposal(
            "radio", active.area, active.area, RadioModelUpdate(t=0.0, area=active.area, version=1), 0.0
        )
        ruling = Gate().of_trials(proposal, trials)
        if ruling.outcome != "more":
            break
    return ruling


class Teacher:
    """The learning service of one area without bus and clock, with every lesson; and fusion's part in it.

    Args:
        site: as its trackers know it.
        active: the area with the radio that is live.
        tracker: name of the tracker that runs.
        ask: tries a candidate; None: fusion's own trial of ``tracker``, here and at once.
        pace: how often what is done; None: as the service, but without rest after trials: it is of machine time.
    """

    def __init__(
        self,
        site: Site,
        active: AreaView,
        tracker: str,
        ask: Callable[[bytes], Mapping[str, Any]] | None = None,
        pace: Pace | None = None,
    ) -> None:
        self.active = active
        self._tracker = tracker
        self._try = ask or self._rescored
        self._chunks: deque[Chunk] = deque()
        self._next: AreaView | None = None
        area = active.area
        tools = Tools(self._pictures, self._ask, Inline(), lambda seconds: None)
        tracks, lessons = areas_of(site, [area]), lessons_of(site, [area], tools)
        self._loop = LearningLoop(tracks, lessons, Gate(), ModelStore(in_memory()), self._ask, self._live, pace)
        if active.shadowing is not None:
            known = RadioModelUpdate(t=0.0, area=area, version=0, model=_file(active))
            tracks[area].activated(known)
            for lesson in lessons:
                if lesson.learner.kind == "radio":
                    lesson.learner.activated(known)

    def consumed(self, chunk: Chunk) -> None:
        """Keep what fusion consumed, for trials."""
        self._chunks.append(chunk)
        while self._chunks[0].t_end < chunk.t_end - RECENT:
            self._chunks.popleft()

    def take(self, message: Message) -> None:
        """Take in what sensors or fusion said."""
        self._loop.take(message)

    def look(self, now: float) -> AreaView | None:
        """Do what is due at ``now``, and return the area with the model that went live; None where none did."""
        self._next = None
        self._loop.look(now)
        return self._next

    def history(self) -> list[Activation]:
        """Return every decision, newest first."""
        return list(self._loop.store.history())

    def _ask(self, area: str, question: bytes) -> Mapping[str, Any]:
        return self._try(question)

    def _rescored(self, question: bytes) -> Mapping[str, Any]:
        return rescore(question, self._chunks, self.active, self._tracker)

    def _pictures(self, camera: str, options: Mapping[str, float]) -> Mapping[str, Any]:
        return {"error": f"camera {camera} has no pictures: its detections are simulated"}

    def _live(self, message: Message) -> None:
        if isinstance(message, RadioModelUpdate):
            self.active = self._next = under_model(self.active, message.model)


def _file(view: AreaView) -> Any:
    shadowing = view.shadowing
    if shadowing is None:
        shape = (len(view.radio.names), 1, 1)
        shadowing = ShadowingMap(view.radio.names, view.lower, 100.0, np.zeros(shape), np.full(shape, 16.0))
    return pack_radio_model(RadioModel(view.site, view.radio, shadowing))
