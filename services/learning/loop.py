"""What learning does, turn by turn, without bus and clock: messages in, decisions out.

Stretches that may teach go to the learners; the learners propose; one proposal at a time is tried by fusion on what is
newer than what taught it; the gate rules; what is decided is stored, then published. A model that went live is on
probation: on what came after, the one it replaced is tried against it, and comes back if it is better.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from typing import Any

import msgspec
import numpy as np
import structlog

from services.learning.activation.gate import Gate, Ruling
from services.learning.activation.kinds import PERSONAL, kind_of, subject_of
from services.learning.activation.questions import is_tried, question_of
from services.learning.activation.rows import Decided, StoredModel
from services.learning.activation.store import ModelStore
from services.learning.area_tracks import AreaTracks
from services.learning.lesson import Alert, Critic, Lesson, Watching, Weighing
from services.learning.proposal import Learner, Proposal
from services.learning.report_draft import ReportDraft, Telling
from services.learning.trials import Ask, Candidate, Inline, Key, Pace, Trials, key_of
from shared.erased import Erased
from shared.learning_report import LearningReport, ModelKind
from shared.messages import Erasure, Message, MotionBatch, RadioScan

__all__ = ["LearningLoop"]

log = structlog.get_logger(__name__)

LONGEST_PROBATION = 86400.0
"""Seconds after which a model stands for which there never was enough to tell."""
MOST_UNTRIED = 1000
"""Proposals kept that nobody could try yet."""


class LearningLoop:
    """Learns, tries, decides. Used by one thread.

    Args:
        areas: where stretches come from, by area.
        lessons: the learners in their places.
        gate: rules on trials.
        store: models and what became of them.
        ask: has fusion of an area answer a question; an answer with ``error`` alone where it cannot.
        publish: sends a model to all; called after it was stored.
        pace: how often.
        activate: whether anything goes live by itself; else candidates are tried and told of only.
        executor: where fusion is asked; ``Inline`` makes ``look`` wait for the answer.
    """

    def __init__(
        self,
        areas: Mapping[str, AreaTracks],
        lessons: Sequence[Lesson],
        gate: Gate,
        store: ModelStore,
        ask: Ask,
        publish: Callable[[Message], None],
        pace: Pace | None = None,
        *,
        activate: bool = True,
        executor: Executor | None = None,
    ) -> None:
        self.areas = areas
        self.lessons = lessons
        self.store = store
        # Asked once: it is much slower than what is asked then, for every message.
        self._watching = [(lesson.areas, lesson.learner) for lesson in lessons if isinstance(lesson.learner, Watching)]
        self._learners = {lesson.name: lesson.learner for lesson in lessons}
        self._gate = gate
        self._publish = publish
        self._pace = pace or Pace()
        self._activate = activate
        self._trials = Trials(gate, ask, executor or Inline(), self._pace, self._live, self._sensor_time)
        self._untried: OrderedDict[Key, Proposal] = OrderedDict()
        """The newest proposal of each kind and subject that was not tried: learners tell each once."""
        self._erased = Erased()
        self._to_forget: set[str] = set()
        """Phones whose rows the database still has to forget."""
        self._to_publish: list[StoredModel] = []
        """Phones' models that were live before the start."""
        self._proposed = self._saved = -math.inf

    # -- in ----------------------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Go on from what was stored: learners know what they knew, live models are published again.

        Those of phones at the first look only: by then it is known whose owners withdrew consent meanwhile.
        """
        for model in self.store.all_active():
            self._judge_under(model)  # before what was known is restored: it was known under this model
        states = self.store.states.read()
        for name, part in self._kept().items():
            if name not in states:
                continue
            try:
                part.restore(msgspec.json.decode(states[name]))
            except ValueError as error:
                log.warning("what was learned is not understood, it begins anew", part=name, reason=str(error))
        for model in self.store.all_active():
            self._go_live(model, publish=model.kind not in PERSONAL)
            if model.kind in PERSONAL:
                self._to_publish.append(model)
        for said in reversed(self.store.history()):
            back = said.decision == "rolled back"
            pause = self._pace.after_roll_back if back else self._pace.after_refusal
            self._trials.wait((said.kind, said.subject), said.t + pause)

    def take(self, message: Message) -> None:
        """Take in one message of the bus."""
        if isinstance(message, Erasure):
            self.forget(message.device)
            return
        if isinstance(message, RadioScan | MotionBatch) and (message.device in self._erased or message.late):
            return
        of = {name for name, area in self.areas.items() if area.take(message, self._erased)}
        if of:
            for areas, learner in self._watching:
                if not of.isdisjoint(areas):
                    learner.watch(message)

    def forget(self, device: str) -> None:
        """Forget a phone whose owner withdrew consent, in memory and in the database."""
        if device not in self._erased:
            self._erased.add(device)
            for area in self.areas.values():
                area.forget(device)
            for lesson in self.lessons:
                lesson.learner.forget(device)
            self._trials.forget(device)
            for kind in PERSONAL:
                self._untried.pop((kind, device), None)
            self._saved = -math.inf  # what is saved of the learners still knows the phone
        self._to_forget.add(device)
        self._forget_stored()

    def _forget_stored(self) -> None:
        """Have the database forget; whom it cannot forget now is remembered for the next look."""
        for device in sorted(self._to_forget):
            self.store.forget(device)
            self._to_forget.discard(device)

    # -- turns -------------------------------------------------------------------------------------------------------

    def look(self, now: float) -> None:
        """Do what is due at ``now``, seconds since the epoch."""
        for area in self.areas.values():
            for stretch, verdict in area.close():
                for lesson in self.lessons:
                    if area.area not in lesson.areas:
                        continue
                    if verdict.good:
                        lesson.learner.learn(stretch)
                    elif isinstance(lesson.learner, Weighing):
                        lesson.learner.learn_doubtful(stretch)
        self._forget_stored()  # before all else that the database is needed for
        while self._to_publish:
            model = self._to_publish.pop()
            if self._live((model.kind, model.subject)) == model.version:
                self._publish(model.model)
        self._finish(now)
        for proposal in self._alarms():
            self._trials.expect(Candidate(proposal))
        if not self._trials.busy:
            self._begin_trial(now)
            self._finish(now)
        if now - self._saved >= self._pace.save or now < self._saved:
            self.save(now)

    def save(self, now: float) -> None:
        """Save what the learners know."""
        states = {name: msgspec.json.encode(part.state(), enc_hook=_plain) for name, part in self._kept().items()}
        self.store.states.save(states, now)
        self._saved = now

    def _kept(self) -> dict[str, Learner | AreaTracks]:
        """Return by name all that knows something worth keeping."""
        return {**{f"tracks/{name}": area for name, area in self.areas.items()}, **self._learners}

    def _begin_trial(self, now: float) -> None:
        if self._trials.go_on(now, urgent=True):
            return
        # What reads models or asks learners is not done at every look.
        due = not 0.0 <= now - self._proposed < self._pace.propose
        if due and (self._begin_probation(now) or self._begin_imported(now)):
            return
        if self._trials.go_on(now) or not due:
            return
        self._proposed = now
        for proposal in self._proposals():
            self._keep(proposal)
        for key, one in list(self._untried.items()):
            if one.trained_until > self._sensor_time(one.area, now):  # time ran back: nothing will judge it soon
                del self._untried[key]
        asking: list[Proposal] = []
        for proposal in [one for key, one in self._untried.items() if self._trials.may_begin(key, now)]:
            if proposal.question and proposal.gain is None:
                asking.append(proposal)
            else:
                self._rule(Candidate(proposal), self._gate.of_its_own(proposal), now)
                self._untried.pop(key_of(proposal), None)
        if asking and self._trials.rested(now):
            # The subject that waited longest; among those never tried, as the learners put them.
            first = min(asking, key=lambda one: self._trials.waited_since(key_of(one)))
            del self._untried[key_of(first)]
            self._trials.start(Candidate(first), first.trained_until, now)

    def _keep(self, proposal: Proposal) -> None:
        """Keep a proposal until it is tried, in the place of an older one of its kind and subject."""
        key = key_of(proposal)
        self._untried.pop(key, None)
        self._untried[key] = proposal
        if len(self._untried) > MOST_UNTRIED:
            self._untried.popitem(last=False)

    def _alarms(self) -> list[Proposal]:
        found: list[Proposal] = []
        for lesson in self.lessons:
            t = self._newest(lesson)
            if isinstance(lesson.learner, Alert) and math.isfinite(t):
                found += lesson.learner.alarms(t)
        return [one for one in found if self._is_sound(one)]

    def _newest(self, lesson: Lesson) -> float:
        return max((self.areas[name].t for name in lesson.areas if name in self.areas), default=-math.inf)

    def _proposals(self) -> list[Proposal]:
        found: list[Proposal] = []
        for lesson in self.lessons:
            t = self._newest(lesson)
            if math.isfinite(t):
                found += lesson.learner.propose(t, t - self._pace.held_out)
        return [one for one in found if self._is_sound(one)]

    def _is_sound(self, proposal: Proposal) -> bool:
        if proposal.kind in PERSONAL and proposal.subject in self._erased:
            return False
        sound = (kind_of(proposal.model), subject_of(proposal.model)) == key_of(proposal)
        if not sound:
            log.error("a proposal is not what it says", kind=proposal.kind, subject=proposal.subject)
        return sound

    def _begin_probation(self, now: float) -> bool:
        """Have what a live model replaced tried against it, on what was measured since."""
        for model in self.store.on_probation():
            key = model.kind, model.subject
            ripe = self._sensor_time(model.area, now) >= model.since + self._pace.held_out
            if now > model.decided + LONGEST_PROBATION:
                self.store.settle(*key)
            elif not is_tried(model.kind):
                self._review(model, self.store.before(model), now)
            elif ripe and self._trials.rested(now) and self._trials.may_begin(key, now):
                former = self.store.before(model)
                question = question_of(former)
                if question is not None:
                    proposal = Proposal(*key, model.area, former, model.since, question)
                    self._trials.start(Candidate(proposal, "former"), model.since, now)
                    return True
        return False

    def _review(self, model: StoredModel, former: Message, now: float) -> None:
        """Settle or take back a live model that fusion cannot try, as its learner says."""
        learners = [lesson.learner for lesson in self.lessons if lesson.learner.kind == model.kind]
        critics = [learner for learner in learners if isinstance(learner, Critic)]
        if not critics:
            self.store.settle(model.kind, model.subject)
        for learner in critics:
            told = learner.regret(former, model.since)
            if told is None:
                continue
            gain, margin = told
            if gain > margin:
                words = f"on what came after, the model before was better by {gain:.3g}, more than {margin:.3g}"
                self.roll_back(model.kind, model.subject, now, words, Ruling("activate", words, gain, margin))
            else:
                self.store.settle(model.kind, model.subject)
            return

    def _begin_imported(self, now: float) -> bool:
        """Have an imported model tried on the last minutes, none of which taught it."""
        if not self._trials.rested(now):
            return False
        for model in self.store.imported():
            key = model.kind, model.subject
            question = question_of(model.model)
            if question is None or not self._trials.may_begin(key, now):
                continue
            since = self._sensor_time(model.area, now) - self._pace.held_out
            proposal = Proposal(*key, model.area, model.model, since, question, evidence=model.evidence)
            self._trials.start(Candidate(proposal, "imported", model), since, now)
            return True
        return False

    def _finish(self, now: float) -> None:
        finished = self._trials.finished(now)
        if finished is None:
            return
        candidate, ruling = finished
        key = key_of(candidate.proposal)
        if candidate.role == "proposed":
            self._untried.setdefault(key, candidate.proposal)  # until it is ruled on, and that is stored
        if ruling.outcome == "later":
            return
        if candidate.role != "former":
            self._rule(candidate, ruling, now)
            if self._untried.get(key) is candidate.proposal:
                del self._untried[key]
        elif ruling.outcome == "activate":
            words = f"on what came after, the model before was better: {ruling.reason}"
            self.roll_back(*key, now, words, ruling)
        else:
            self.store.settle(*key)

    # -- decisions ---------------------------------------------------------------------------------------------------

    def _rule(self, candidate: Candidate, ruling: Ruling, now: float) -> None:
        proposal, reason = candidate.proposal, ruling.reason
        wins = ruling.outcome == "activate"
        allowed = self._activate and not self.store.frozen
        if wins and not allowed:
            reason = f"would go live ({reason}), but activation is switched off"
        how = Decided(
            t=now,
            since=self._sensor_time(proposal.area, now),
            reason=f"{proposal.reason}: {reason}" if proposal.reason else reason,
            gain=ruling.gain,
            margin=ruling.margin,
            evidence={**proposal.evidence, **ruling.evidence},
        )
        self._trials.wait(key_of(proposal), now + self._pace.after_refusal)
        where = (proposal.model, *key_of(proposal), proposal.area)
        stored = candidate.stored
        if wins and allowed:
            model = self.store.activate(*where, how) if stored is None else self.store.promote(stored, how)
            log.info("a model goes live", kind=model.kind, subject=model.subject, version=model.version, reason=reason)
            self._go_live(model)
        elif stored is None:
            self.store.refuse(*where, how)
        else:
            self.store.judged(stored, how)

    def roll_back(
        self, kind: ModelKind, subject: str, now: float, reason: str, ruling: Ruling | None = None
    ) -> StoredModel:
        """Return to the model before the live one; ``ruling`` None: because an operator says so.

        Raises:
            NoSuchModelError: nothing is live but what is configured.
        """
        live = self.store.active(kind, subject)
        how = Decided(
            t=now,
            since=now if live is None else self._sensor_time(live.area, now),
            reason=reason,
            gain=None if ruling is None else ruling.gain,
            margin=None if ruling is None else ruling.margin,
            by="operator" if ruling is None else "learning",
        )
        model = self.store.roll_back(kind, subject, how)
        log.warning("a model goes back", kind=kind, subject=subject, version=model.version, reason=reason)
        self._trials.wait((kind, subject), now + self._pace.after_roll_back)
        self._go_live(model)
        return model

    def put_live(self, model: StoredModel, now: float, reason: str) -> StoredModel:
        """Make a stored model live because an operator says so."""
        how = Decided(t=now, since=self._sensor_time(model.area, now), reason=reason, by="operator")
        live = self.store.promote(model, how)
        self._go_live(live)
        return live

    def _judge_under(self, model: StoredModel) -> None:
        if model.kind == "radio" and model.area in self.areas:
            self.areas[model.area].activated(model.model)

    def _go_live(self, model: StoredModel, *, publish: bool = True) -> None:
        self._untried.pop((model.kind, model.subject), None)  # it was made to be better than the one before
        if publish:
            self._publish(model.model)
        self._judge_under(model)
        for lesson in self.lessons:
            if lesson.learner.kind == model.kind and model.area in lesson.areas:
                lesson.learner.activated(model.model)

    # -- words -------------------------------------------------------------------------------------------------------

    def report(self, now: float) -> LearningReport:
        """Return everything at once."""
        draft = ReportDraft()
        for name, area in self.areas.items():
            draft.area(name, version=self._live(("radio", name)), words=self.words(name))
            area.tell(draft)
        for lesson in self.lessons:
            if isinstance(lesson.learner, Telling):
                lesson.learner.tell(draft)
        return draft.report(now, self.store.frozen, self.store.history())

    def words(self, area: str) -> str:
        """Return what learning is doing or waiting for in an area."""
        if told := self._trials.words(area):
            return told
        if not math.isfinite(self.areas[area].t):
            return "waits: fusion has told no tracks yet"
        if not math.isfinite(self.areas[area].taught):
            return "waits: nobody with a phone has walked where cameras see well enough to teach"
        return "learns"

    def has_forgotten(self, device: str) -> bool:
        """Whether a phone's owner withdrew consent."""
        return device in self._erased

    def _live(self, key: Key) -> int:
        return self.store.live_version(*key)

    def _sensor_time(self, area: str, now: float) -> float:
        known = self.areas.get(area)
        return now if known is None or not math.isfinite(known.t) else known.t


def _plain(value: Any) -> Any:
    """Return a number or an array of NumPy's, which slip into states, as JSON can hold it."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise NotImplementedError(f"a state holds {type(value).__name__}; allowed: what JSON can hold")
