"""Which candidate is being tried: one at a time, on one stretch of held-out time after the other until it is clear."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from typing import Any, Literal

from services.learning.activation.answer import Trial, read_answer
from services.learning.activation.gate import Gate, Ruling
from services.learning.activation.kinds import PERSONAL
from services.learning.activation.questions import held_out
from services.learning.activation.rows import StoredModel
from services.learning.proposal import Proposal
from shared.learning_report import ModelKind

__all__ = ["Ask", "Candidate", "Inline", "Key", "Pace", "Trials", "key_of"]

Key = tuple[ModelKind, str]
"""A kind of model and what it is of."""
Ask = Callable[[str, bytes], Mapping[str, Any]]
SUBJECTS_REMEMBERED = 10_000


@dataclass(frozen=True)
class Pace:
    """How often what is done; seconds.

    Attributes:
        propose: between two times learners are asked what deserves a trial.
        held_out: what is so new teaches nothing yet: it judges.
        urgent: what comes after an urgent candidate and judges it; long enough for the gate.
        again: until a subject is tried again for which there was too little to tell.
        after_refusal: until another candidate of the same subject is tried: not on the time that refused the last.
        after_roll_back: the same after a model had to go back.
        save: between two times what learners know is saved.
        rest: after a trial nothing is tried for so many times what fusion computed for it; seconds of the machine, so
            none in experiments, whose time is not the machine's.
        urgent_rest: the same before an urgent candidate.
    """

    propose: float = 60.0
    held_out: float = 240.0
    urgent: float = 90.0
    again: float = 60.0
    after_refusal: float = 240.0
    after_roll_back: float = 3600.0
    save: float = 300.0
    rest: float = 0.0
    urgent_rest: float = 0.0


@dataclass(frozen=True)
class Candidate:
    """What is tried against the live model.

    Attributes:
        proposal: the model.
        role: what a learner proposed, what was imported, or what the live model replaced.
        stored: the row of an imported one.
    """

    proposal: Proposal
    role: Literal["proposed", "imported", "former"] = "proposed"
    stored: StoredModel | None = None


class Inline(Executor):
    """Does at once what it is given, in the thread that gives it: for experiments."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Return the future of what was done already."""
        done: Future[Any] = Future()
        try:
            done.set_result(fn(*args, **kwargs))
        except Exception as error:
            done.set_exception(error)
        return done


@dataclass(frozen=True)
class _Asked:
    """``trials``: what came of it on earlier time; ``until``: the sensors' time when it was asked."""

    candidate: Candidate
    trials: tuple[Trial, ...]
    live: int
    until: float
    answer: Future[Mapping[str, Any]]


@dataclass(frozen=True)
class _Open:
    """``since``: the sensors' time up to which it was tried; ``live``: the version it was tried against."""

    candidate: Candidate
    trials: tuple[Trial, ...]
    live: int
    since: float


class Trials:
    """Has candidates tried and ruled on.

    Args:
        gate: rules.
        ask: has fusion of an area answer a question.
        executor: where it is asked.
        pace: how long is waited.
        live: version of the model of a kind and subject that is live now.
        sensor_time: of an area: the newest its sensors told.
    """

    def __init__(
        self,
        gate: Gate,
        ask: Ask,
        executor: Executor,
        pace: Pace,
        live: Callable[[Key], int],
        sensor_time: Callable[[str, float], float],
    ) -> None:
        self._gate = gate
        self._ask = ask
        self._executor = executor
        self._pace = pace
        self._live = live
        self._sensor_time = sensor_time
        self._asked: _Asked | None = None
        self._open: OrderedDict[Key, _Open] = OrderedDict()
        """Candidates that were better, but not surely: they wait for more held-out time."""
        self._not_before: OrderedDict[Key, float] = OrderedDict()
        """When a subject may be tried again, wall clock."""
        self._ended, self._took = -math.inf, 0.0
        """When the last trial ended, and seconds that were computed for it."""
        self._gone: set[str] = set()
        """Phones whose owners withdrew consent since the trial under way began."""
        self._words: dict[str, str] = {}
        """By area, what the last trial came to where nothing was decided."""

    @property
    def busy(self) -> bool:
        """Whether a candidate is being tried."""
        return self._asked is not None

    def may_begin(self, key: Key, now: float) -> bool:
        """Whether a candidate of this kind and subject may be tried."""
        until = self._not_before.get(key, -math.inf)
        # Nobody waits for longer than that: the clock was set back.
        longest = max(self._pace.again, self._pace.after_refusal, self._pace.after_roll_back)
        return key not in self._open and not now < until <= now + longest

    def rested(self, now: float, *, urgent: bool = False) -> bool:
        """Whether the last trial is so long ago that learning takes no more than its share of a core."""
        rest = self._took * (self._pace.urgent_rest if urgent else self._pace.rest)
        return not 0.0 <= now - self._ended < rest

    def waited_since(self, key: Key) -> float:
        """Return since when a candidate of this kind and subject might have been tried; -inf: none ever was."""
        return self._not_before.get(key, -math.inf)

    def wait(self, key: Key, until: float) -> None:
        """Try no candidate of this kind and subject before ``until``."""
        self._not_before.pop(key, None)
        self._not_before[key] = until
        if len(self._not_before) > SUBJECTS_REMEMBERED:
            self._not_before.popitem(last=False)

    def start(self, candidate: Candidate, since: float, now: float, trials: tuple[Trial, ...] = ()) -> None:
        """Have a candidate tried on what was measured after ``since``."""
        proposal = candidate.proposal
        answer = self._executor.submit(self._ask, proposal.area, held_out(proposal.question, since))
        until = self._sensor_time(proposal.area, now)
        self._gone.clear()
        self._asked = _Asked(candidate, trials, self._live(key_of(proposal)), until, answer)

    def expect(self, candidate: Candidate) -> None:
        """Have an urgent candidate tried as soon as there is time enough that is newer than what taught it."""
        key = key_of(candidate.proposal)
        before = self._open.get(key)
        if before is None or not before.candidate.proposal.urgent:
            self._open[key] = _Open(candidate, (), self._live(key), candidate.proposal.trained_until)
            self._open.move_to_end(key, last=False)

    def go_on(self, now: float, *, urgent: bool = False) -> bool:
        """Have a candidate that is not clear yet tried on the time since; whether there was one.

        ``urgent``: only such a one.
        """
        for key, one in list(self._open.items()):
            if (urgent and not one.candidate.proposal.urgent) or not self.rested(now, urgent=urgent):
                continue
            t = self._sensor_time(one.candidate.proposal.area, now)
            if one.live != self._live(key) or t < one.since:  # another model is live, or time ran back
                del self._open[key]
            elif t >= one.since + (self._pace.urgent if one.candidate.proposal.urgent else self._pace.held_out):
                del self._open[key]
                self.start(one.candidate, one.since, now, one.trials)
                return True
        return False

    def finished(self, now: float) -> tuple[Candidate, Ruling] | None:
        """Return what the gate decided of the candidate whose trial ended; None: nothing is decided now.

        "later": nothing was tried, and nothing is kept of the candidate.
        """
        asked = self._asked
        if asked is None or not asked.answer.done():
            return None
        self._asked = None
        proposal, key = asked.candidate.proposal, key_of(asked.candidate.proposal)
        error = asked.answer.exception()
        told = asked.answer.result() if error is None else {"error": f"fusion of area {proposal.area}: {error}"}
        trial = read_answer(told)
        self._ended, self._took = now, trial.took
        if asked.live != self._live(key):
            return None  # it was tried against what is no longer live
        if not self._gone.isdisjoint(trial.devices):
            return asked.candidate, Ruling("later", "somebody it was tried on withdrew consent meanwhile")
        trials = (*asked.trials, trial)
        ruling = self._gate.of_trials(proposal, trials)
        if ruling.outcome in ("activate", "refuse"):
            self._words.pop(proposal.area, None)
            return asked.candidate, ruling
        self._words[proposal.area] = ruling.reason
        if ruling.outcome == "later":
            self.wait(key, now + self._pace.again)
            trials = asked.trials
        if not trials and not proposal.urgent:
            return asked.candidate, ruling
        if key not in self._open:
            self._open[key] = _Open(asked.candidate, trials, asked.live, asked.until)
        return None

    def forget(self, device: str) -> None:
        """Forget candidates of one phone, and what other candidates' trials say of it."""
        asked = self._asked
        if asked is not None:
            self._gone.add(device)
            if _names(asked.trials, device):
                self._asked = replace(asked, trials=())
        for kind in PERSONAL:
            self._open.pop((kind, device), None)
            self._not_before.pop((kind, device), None)
            if asked is not None and key_of(asked.candidate.proposal) == (kind, device):
                self._asked = None
        self._open = OrderedDict((key, one) for key, one in self._open.items() if not _names(one.trials, device))

    def words(self, area: str) -> str:
        """Return what is being tried or waited for in an area; empty: nothing."""
        if self._asked is not None and self._asked.candidate.proposal.area == area:
            what = {"proposed": "a candidate", "imported": "an imported model", "former": "the model before"}
            return f"{what[self._asked.candidate.role]} is being tried: {self._asked.candidate.proposal.kind}"
        return f"waits: {self._words[area]}" if area in self._words else ""


def key_of(proposal: Proposal) -> Key:
    """Return the kind and subject of a proposal."""
    return proposal.kind, proposal.subject


def _names(trials: tuple[Trial, ...], device: str) -> bool:
    return any(device in trial.devices for trial in trials)
