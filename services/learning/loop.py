"""What learning does, turn by turn, without bus and clock: messages in, decisions out.

Stretches that may teach go to the learners; the learners propose; one proposal at a time is tried by fusion on what is
newer than what taught it; the gate rules; what is decided is stored, then published. A model that went live is on
probation: on what came after, the one it replaced is tried against it, and comes back if it is better.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress

import msgspec

from services.learning.activation.gate import Gate
from services.learning.activation.kinds import PERSONAL
from services.learning.activation.questions import question_of
from services.learning.activation.states import ASIDE, KEPT
from services.learning.activation.store import ModelStore
from services.learning.area_tracks import AreaTracks
from services.learning.decisions import Decisions
from services.learning.last_heard import HOUR, LastHeard
from services.learning.lesson import Lesson
from services.learning.lessons import Lessons
from services.learning.probation import Probation
from services.learning.proposal import Proposal
from services.learning.report_draft import ReportDraft
from services.learning.trials import Ask, Candidate, Inline, Key, Pace, Trials, key_of
from services.learning.untried import Untried
from shared.erased import Erased
from shared.learning_report import LearningReport
from shared.messages import Erasure, Message, MotionBatch, RadioScan

__all__ = ["LearningLoop"]

PHONES = "phones"
"""Under which it is kept when phones were heard last."""
AT_ONCE = 100
"""Phones forgotten in one turn because they stayed away."""


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
        retract: keeps a phone's models no longer for who joins later.
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
        retract: Callable[[str], None] = lambda device: None,
    ) -> None:
        self.store = store
        self._retract = retract
        self.lessons = Lessons(areas, lessons)
        self._gate = gate
        self._pace = pace = pace or Pace()
        self._trials = Trials(gate, ask, executor or Inline(), pace, self._live, self._sensor_time)
        self._untried = Untried()
        self.decisions = Decisions(
            store, self.lessons, self._trials, self._untried, publish, pace, self._sensor_time, activate=activate
        )
        self._probation = Probation(store, self.lessons, self._trials, self.decisions, pace, self._sensor_time)
        self._erased = Erased()
        self._to_forget: set[str] = set()
        """Phones whose rows the database still has to forget."""
        self._withdrawn = False
        """Whether what is saved of the learners may still know somebody who withdrew."""
        self._heard = LastHeard()
        self._set_aside: dict[str, bool] = {}
        self._proposed = self._saved = self._let_go = -math.inf

    @property
    def areas(self) -> Mapping[str, AreaTracks]:
        """Where stretches come from, by area."""
        return self.lessons.areas

    # -- in ----------------------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Go on from what was stored: learners know what they knew, live models are published again.

        Those of phones at the first look only: by then it is known whose owners withdrew consent meanwhile.
        """
        for model in self.store.all_active():
            self.lessons.judge_under(model)  # before what was known is restored: it was known under this model
        states = self.store.states.read()
        aside = {name.removeprefix(ASIDE): state for name, state in states.items() if name.startswith(ASIDE)}
        self._set_aside = self.lessons.restore(states, aside)
        for name, back in self._set_aside.items():
            self.store.states.set_aside(name, back=back)
        if PHONES in states:
            with suppress(ValueError):  # then their time begins now
                self._heard.restore(msgspec.json.decode(states[PHONES]))
        self.decisions.resume()

    def take(self, message: Message) -> None:
        """Take in one message of the bus."""
        if isinstance(message, Erasure):
            self.forget(message.device)
            return
        if isinstance(message, RadioScan | MotionBatch) and (message.device in self._erased or message.late):
            return
        if isinstance(message, RadioScan | MotionBatch):
            self._heard.hear(message.device)
        self.lessons.take(message, self._erased)

    def forget(self, device: str) -> None:
        """Forget a phone whose owner withdrew consent, in memory and in the database."""
        if device not in self._erased:
            self._erased.add(device)
            self._forget(device)
        self._to_forget.add(device)
        self._forget_stored()

    def holds(self, device: str) -> bool:
        """Whether something of a phone whose owner withdrew consent may still be in the database."""
        return self._withdrawn or device in self._to_forget

    def _forget(self, device: str) -> None:
        self.lessons.forget(device)
        self._trials.forget(device)
        self._untried.forget(device)
        self._heard.forget(device)
        self._withdrawn = True

    def _forget_stored(self) -> None:
        """Have the database forget; whom it cannot forget now is remembered for the next look."""
        for device in sorted(self._to_forget):
            self.store.forget(device)
            self.store.states.forget(device, self._names)
            self._to_forget.discard(device)

    def _let_go_of_absent(self, now: float) -> None:
        """Forget phones that were not heard for a month, and what nobody here has used for as long; once an hour."""
        if 0.0 <= now - self._let_go < HOUR:
            return
        absent = self._heard.look(self.store.phones() | self.lessons.devices(), now)
        for device in absent[:AT_ONCE]:
            self._forget(device)
            self._retract(device)
            self.store.forget(device)
        if len(absent) <= AT_ONCE:  # else the others at the next look
            self.store.states.let_go(self._names, now - KEPT)
            self._let_go = now

    @property
    def _names(self) -> list[str]:
        """Under which names this process keeps what it knows."""
        return [*self.lessons.names, PHONES]

    # -- turns -------------------------------------------------------------------------------------------------------

    def look(self, now: float) -> None:
        """Do what is due at ``now``, seconds since the epoch."""
        self.lessons.look(now)
        self.lessons.teach()
        self._forget_stored()  # before all else that the database is needed for
        self._let_go_of_absent(now)
        self.decisions.retire(now)
        self.lessons.inform(self.store.all_active)
        self.decisions.publish_phones()
        self._finish(now)
        for proposal in self.lessons.alarms():
            if not self._wanted(proposal):
                continue
            if proposal.question:
                self._trials.expect(Candidate(proposal))
            else:
                self.decisions.rule(Candidate(proposal), self._gate.of_its_own(proposal), now)
        if not self._trials.busy:
            self._begin_trial(now)
            self._finish(now)
        if self._withdrawn or now - self._saved >= self._pace.save or now < self._saved:
            self.save(now)

    def save(self, now: float) -> None:
        """Save what the learners know.

        Of who cannot tell it stays what was saved before, unless somebody withdrew since: it may know them.
        """
        states, untold = self.lessons.states()
        states[PHONES] = msgspec.json.encode(self._heard.state())
        self.store.states.save(states, now, untold if self._withdrawn else ())
        self._withdrawn = False
        self._saved = now

    def _begin_trial(self, now: float) -> None:
        if self._trials.go_on(now, urgent=True):
            return
        # What reads models or asks learners is not done at every look.
        due = not 0.0 <= now - self._proposed < self._pace.propose
        if due and (self._probation.begin(now) or self._begin_imported(now)):
            return
        if self._trials.go_on(now) or not due:
            return
        self._proposed = now
        for proposal in self.lessons.proposals(self._pace.held_out):
            if self._wanted(proposal):
                self._untried.keep(proposal)
        asking: list[Proposal] = []
        for proposal in self._untried.ready(
            lambda key: self._trials.may_begin(key, now), lambda area: self._sensor_time(area, now)
        ):
            if proposal.question and proposal.gain is None:
                asking.append(proposal)
            else:
                self.decisions.rule(Candidate(proposal), self._gate.of_its_own(proposal), now)
                self._untried.drop(key_of(proposal))
        if asking and self._trials.rested(now):
            # The subject that waited longest; among those never tried, as the learners put them.
            first = min(asking, key=lambda one: self._trials.waited_since(key_of(one)))
            self._untried.drop(key_of(first))
            self._trials.start(Candidate(first), first.trained_until, now)

    def _wanted(self, proposal: Proposal) -> bool:
        return not (proposal.kind in PERSONAL and proposal.subject in self._erased)

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
        if candidate.role == "proposed":
            self._untried.keep_again(candidate.proposal)  # until it is ruled on, and that is stored
        if ruling.outcome == "later":
            return
        if candidate.role == "former":
            self._probation.finish(candidate, ruling, now)
        else:
            self.decisions.rule(candidate, ruling, now)
            self._untried.ruled(candidate.proposal)

    # -- words -------------------------------------------------------------------------------------------------------

    def report(self, now: float) -> LearningReport:
        """Return everything at once."""
        draft = ReportDraft()
        troubles = self.troubles()
        for name in self.areas:
            words = [self.words(name), *(words for areas, words in troubles.values() if name in areas)]
            draft.area(name, version=self._live(("radio", name)), words="; ".join(words))
        self.lessons.tell(draft)
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

    def troubles(self) -> dict[str, tuple[frozenset[str], str]]:
        """Return by name of who could not do something lately its areas, and what that was in plain words."""
        return self.lessons.troubles()

    def set_aside(self) -> dict[str, str]:
        """Return by name of who did not understand what it knew at the start what became of that, in plain words."""
        days = f"{KEPT / 86400.0:.0f} days"
        anew = (
            "what it knew is not understood by this program or does not fit the site file: it learns anew; "
            f"what it knew is kept for {days}, and used again by a start that understands it"
        )
        again = f"goes on from what was set aside before; what was learned in between is set aside for {days}"
        return {name: f"lesson {name}: {again if back else anew}" for name, back in self._set_aside.items()}

    def has_forgotten(self, device: str) -> bool:
        """Whether a phone's owner withdrew consent."""
        return device in self._erased

    def _live(self, key: Key) -> int:
        return self.store.live_version(*key)

    def _sensor_time(self, area: str, now: float) -> float:
        known = self.areas.get(area)
        return now if known is None or not math.isfinite(known.t) else known.t
