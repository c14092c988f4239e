"""Whether a model that went live should have: on what came after, the one it replaced is tried against it."""

from __future__ import annotations

from collections.abc import Callable

from services.learning.activation.gate import Ruling
from services.learning.activation.questions import is_tried, question_of
from services.learning.activation.rows import StoredModel
from services.learning.activation.store import ModelStore
from services.learning.decisions import Decisions
from services.learning.lessons import Lessons
from services.learning.proposal import Proposal
from services.learning.trials import Candidate, Pace, Trials, key_of
from shared.messages import Message

__all__ = ["Probation"]

LONGEST = 86400.0
"""Seconds after which a model stands for which there never was enough to tell."""


class Probation:
    """Settles live models or takes them back.

    Args:
        store: which models are on probation.
        lessons: judge the kinds that fusion cannot try.
        trials: has the others tried.
        decisions: takes models back.
        pace: how much must have come after.
        sensor_time: of an area: the newest its sensors told, or else the clock it is given.
    """

    def __init__(
        self,
        store: ModelStore,
        lessons: Lessons,
        trials: Trials,
        decisions: Decisions,
        pace: Pace,
        sensor_time: Callable[[str, float], float],
    ) -> None:
        self._store = store
        self._lessons = lessons
        self._trials = trials
        self._decisions = decisions
        self._pace = pace
        self._sensor_time = sensor_time

    def begin(self, now: float) -> bool:
        """Have what a live model replaced tried against it, on what was measured since; whether there was one."""
        for model in self._store.on_probation():
            key = model.kind, model.subject
            ripe = self._sensor_time(model.area, now) >= model.since + self._pace.held_out
            if now > model.decided + LONGEST:
                self._store.settle(*key)
            elif not is_tried(model.kind):
                self._review(model, self._store.before(model), now)
            elif ripe and self._trials.rested(now) and self._trials.may_begin(key, now):
                former = self._store.before(model)
                question = question_of(former)
                if question is not None:
                    proposal = Proposal(*key, model.area, former, model.since, question)
                    self._trials.start(Candidate(proposal, "former"), model.since, now)
                    return True
        return False

    def _review(self, model: StoredModel, former: Message, now: float) -> None:
        """Settle or take back a live model that fusion cannot try, as its learner says."""
        critics = self._lessons.critics(model.kind)
        if not critics:
            self._store.settle(model.kind, model.subject)
        for critic in critics:
            told = self._lessons.regret(critic, former, model.since)
            if told is None:
                continue
            gain, margin = told
            if gain > margin:
                words = f"on what came after, the model before was better by {gain:.3g}, more than {margin:.3g}"
                ruling = Ruling("activate", words, gain, margin)
                self._decisions.roll_back(model.kind, model.subject, now, words, ruling)
            else:
                self._store.settle(model.kind, model.subject)
            return

    def finish(self, candidate: Candidate, ruling: Ruling, now: float) -> None:
        """Settle or take back the live model, as the trial of the one before says."""
        key = key_of(candidate.proposal)
        if ruling.outcome == "activate":
            words = f"on what came after, the model before was better: {ruling.reason}"
            self._decisions.roll_back(*key, now, words, ruling)
        else:
            self._store.settle(*key)
