"""What is decided of a model: it is stored first, and then told to all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import structlog

from services.learning.activation.bundle import Incoming
from services.learning.activation.gate import Ruling
from services.learning.activation.kinds import PERSONAL
from services.learning.activation.rows import Decided, StoredModel
from services.learning.activation.store import ModelStore
from services.learning.lessons import Lessons
from services.learning.trials import Candidate, Key, Pace, Trials, key_of
from services.learning.untried import Untried
from shared.keys import is_identifier
from shared.learning_report import ModelKind
from shared.messages import Message

__all__ = ["Decisions"]

log = structlog.get_logger(__name__)


class Decisions:
    """Activates, refuses and takes back.

    Args:
        store: models and what became of them.
        lessons: are told what goes live.
        trials: leaves subjects alone for a while.
        untried: proposals that were made to be better than what was live.
        publish: sends a model to all; called after it was stored.
        pace: how long subjects are left alone.
        sensor_time: of an area: the newest its sensors told, or else the clock it is given.
        activate: whether anything goes live by itself.
    """

    def __init__(
        self,
        store: ModelStore,
        lessons: Lessons,
        trials: Trials,
        untried: Untried,
        publish: Callable[[Message], None],
        pace: Pace,
        sensor_time: Callable[[str, float], float],
        *,
        activate: bool,
    ) -> None:
        self._store = store
        self._lessons = lessons
        self._trials = trials
        self._untried = untried
        self._publish = publish
        self._pace = pace
        self._sensor_time = sensor_time
        self._activate = activate
        self._outlived: list[StoredModel] = []
        """Live models of calibrations that their cameras have no more."""
        self._to_publish: list[StoredModel] = []
        """Phones' models that were live before the start."""
        self._untold: dict[Key, str] = {}
        """Live models that could not be published, and why."""

    def untold(self) -> list[str]:
        """Return of each live model that could not be published what it is and why; phones are not named."""
        return [
            f"the live {kind} model of {'a phone' if kind in PERSONAL else subject} is not in use: {why}"
            for (kind, subject), why in sorted(self._untold.items())
        ]

    def resume(self) -> None:
        """Publish what was live before the start, and leave alone what was decided on lately.

        Phones' models wait for ``publish_phones``.
        """
        for model in self._store.all_active():
            if self._store.outlived(model.model):
                self._outlived.append(model)
                continue
            if why := self._store.problem(model.model):
                self._told(model, why)  # learners go on as if nothing were live: nobody uses it
                continue
            self._go_live(model, publish=model.kind not in PERSONAL)
            if model.kind in PERSONAL:
                self._to_publish.append(model)
        for said in reversed(self._store.history()):
            back = said.decision == "rolled back"
            pause = self._pace.after_roll_back if back else self._pace.after_refusal
            self._trials.wait((said.kind, said.subject), said.t + pause)

    def retire(self, now: float) -> None:
        """Take back corrections of cameras that were calibrated anew: what was learned is not true of what is now."""
        while self._outlived:
            model = self._outlived[-1]
            if self._store.live_version(model.kind, model.subject) == model.version:
                reason = f"camera {model.subject} was calibrated anew; this was learned for the calibration before"
                how = Decided(t=now, since=self._sensor_time(model.area, now), reason=reason, by="learning")
                log.info("a model is taken back", kind=model.kind, subject=model.subject, reason=reason)
                self._go_live(self._store.roll_back(model.kind, model.subject, how))
            self._outlived.pop()  # only now: a database that is away is asked again

    def publish_phones(self) -> None:
        """Publish phones' models of before the start that are still live: it is known by now who withdrew meanwhile."""
        while self._to_publish:
            model = self._to_publish.pop()
            if self._store.live_version(model.kind, model.subject) == model.version:
                self._send(model)

    def rule(self, candidate: Candidate, ruling: Ruling, now: float) -> None:
        """Do with a candidate what the gate says, as far as anything may go live."""
        proposal, reason = candidate.proposal, ruling.reason
        wins = ruling.outcome == "activate"
        allowed = self._activate and not self._store.frozen
        if wins and (why := self._store.problem(proposal.model)):
            wins, reason = False, f"would go live ({reason}), but no such model can be used: {why}"
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
        if proposal.question or not proposal.urgent:  # else no held-out time was used up
            self._trials.wait(key_of(proposal), now + self._pace.after_refusal)
        where = (proposal.model, *key_of(proposal), proposal.area)
        stored = candidate.stored
        if wins and allowed:
            model = self._store.activate(*where, how) if stored is None else self._store.promote(stored, how)
            log.info("a model goes live", kind=model.kind, subject=model.subject, version=model.version, reason=reason)
            self._go_live(model)
        elif stored is None:
            self._store.refuse(*where, how)
        elif wins:
            log.info("an imported model waits", kind=stored.kind, subject=stored.subject, reason=reason)
        else:
            self._store.judged(stored, how)

    def roll_back(
        self, kind: ModelKind, subject: str, now: float, reason: str, ruling: Ruling | None = None
    ) -> StoredModel:
        """Return to the model before the live one; ``ruling`` None: because an operator says so.

        Raises:
            NoSuchModelError: no model of the kind and subject ever went live.
            NothingBeforeError: it is as configured already.
        """
        live = self._store.active(kind, subject)
        how = Decided(
            t=now,
            since=now if live is None else self._sensor_time(live.area, now),
            reason=reason,
            gain=None if ruling is None else ruling.gain,
            margin=None if ruling is None else ruling.margin,
            by="operator" if ruling is None else "learning",
        )
        model = self._store.roll_back(kind, subject, how)
        log.warning("a model goes back", kind=kind, subject=subject, version=model.version, reason=reason)
        self._trials.wait((kind, subject), now + self._pace.after_roll_back)
        self._go_live(model)
        return model

    def put_live(self, model: StoredModel, now: float, reason: str) -> StoredModel:
        """Make a stored model live because an operator says so.

        Raises:
            UnusableModelError: nobody could use it; nothing has changed.
        """
        live = self._store.promote(model, self._by_hand(model.area, now, reason))
        self._go_live(live)
        return live

    def take_in(self, models: Sequence[Incoming], now: float, who: str, *, live: bool) -> list[StoredModel]:
        """Take in models from elsewhere, all or none: they wait, or are live at once because an operator says so.

        Raises:
            UnusableModelError: nobody could use one that is to be live; nothing has changed.
        """
        hand = "; activated by hand, untried" if live else ""
        taken = self._store.take_in_all(
            [(one.model, one.kind, one.subject, one.area) for one in models],
            [replace(self._by_hand(one.area, now, one.reason + who + hand), evidence=one.evidence) for one in models],
            live=live,
        )
        for model in taken if live else []:
            self._go_live(model)
        return taken

    def forget(self, device: str) -> None:
        """Forget what could not be published of a phone whose owner withdrew consent."""
        for kind in PERSONAL:
            self._untold.pop((kind, device), None)

    def _by_hand(self, area: str, now: float, reason: str) -> Decided:
        return Decided(t=now, since=self._sensor_time(area, now), reason=reason, by="operator")

    def _go_live(self, model: StoredModel, *, publish: bool = True) -> None:
        self._untried.drop((model.kind, model.subject))  # it was made to be better than the one before
        self._untold.pop((model.kind, model.subject), None)
        if publish:
            self._send(model)
        self._lessons.activated(model)

    def _send(self, model: StoredModel) -> None:
        """Publish a live model; what cannot be published is told of and ends nothing."""
        if not is_identifier(model.subject):
            return  # as configured: nobody was ever told otherwise under such a name
        try:
            self._publish(model.model)
        except (ValueError, TypeError, OverflowError) as error:  # the model's fault: so it would be at every start
            self._told(model, f"it could not be published ({type(error).__name__}); the log says more", error)

    def _told(self, model: StoredModel, why: str, error: Exception | None = None) -> None:
        log.error("a live model is not in use", kind=model.kind, version=model.version, reason=why, exc_info=error)
        self._untold[model.kind, model.subject] = why
