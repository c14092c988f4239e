"""Models as rows: what is live, what was, what was refused and why. One transaction per decision.

Whatever is decided is stored first and published then: a process that is killed in between publishes it when it
starts again, for at every start all active models are published anew.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import msgspec
from sqlalchemy import Engine, delete, func, select
from sqlalchemy.orm import Session

from services.learning.activation.kinds import PERSONAL, as_configured, numbered, read_model
from services.learning.activation.tables import DecisionRow, LearnerRow, ModelRow, SwitchRow
from shared.learning_report import Activation, ModelKind
from shared.messages import Message, MessageError, encode

__all__ = ["Decided", "ModelState", "ModelStore", "NoSuchModelError", "StoredModel"]

ModelState = Literal["imported", "active", "superseded", "refused", "rolled back"]
By = Literal["learning", "operator"]
KEPT_MODELS = 12
"""Rows of one kind and subject, besides the active one and the one it replaced …"""
KEPT_REFUSED = 3
"""… of them refused ones: large, and of no use but to see why."""
KEPT_DECISIONS = 2000

_decision = msgspec.json.Decoder(Activation)


class NoSuchModelError(LookupError):
    """There is no such model: the text says what there is instead."""


@dataclass(frozen=True)
class StoredModel:
    """A model as it is stored.

    Attributes:
        kind: of model.
        subject: the area, camera or device it is of.
        area: whose fusion tries it.
        version: counts per kind and subject, refused ones included.
        state: what became of it.
        model: the message, numbered.
        decided: when it got its state, wall clock, seconds since the epoch.
        since: the sensors' time then; what is newer was measured under it.
        replaced: version that was active before; 0: as configured.
        probation: whether it is still to be held against that one.
        reason: in plain words.
        evidence: numbers by name.
    """

    kind: ModelKind
    subject: str
    area: str
    version: int
    state: ModelState
    model: Message
    decided: float
    since: float
    replaced: int
    probation: bool
    reason: str
    evidence: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Decided:
    """What is written down with a decision.

    Attributes:
        t: wall clock, seconds since the epoch.
        since: the sensors' time.
        reason: in plain words.
        gain: nats per reading, or as the learner counts; None where nothing was scored.
        margin: what it had to be.
        evidence: numbers by name; what is not finite is left out.
        by: who decided.
    """

    t: float
    since: float
    reason: str
    gain: float | None = None
    margin: float | None = None
    evidence: Mapping[str, float] = field(default_factory=dict)
    by: By = "learning"


class ModelStore:
    """The models of one site. Used by one thread.

    Args:
        engine: an open database with learning's tables.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._digests: dict[str, bytes] = {}
        """Of the states that are stored, by name."""

    # -- what there is ---------------------------------------------------------------------------------------------

    def active(self, kind: ModelKind, subject: str) -> StoredModel | None:
        """Return the model that is live; None: as configured."""
        with Session(self._engine) as session:
            row = _active(session, kind, subject)
            return None if row is None else _stored(row)

    def live_version(self, kind: ModelKind, subject: str) -> int:
        """Return the version that is live, without reading the model; 0: as configured."""
        with Session(self._engine) as session:
            where = (*_which(kind, subject), ModelRow.state == "active")
            return session.scalar(select(ModelRow.version).where(*where)) or 0

    def all_active(self) -> list[StoredModel]:
        """Return all live models; a row that cannot be read any more is left out."""
        return self._read(ModelRow.state == "active")

    def on_probation(self) -> list[StoredModel]:
        """Return the live models that are still to be held against those they replaced."""
        return self._read(ModelRow.probation)

    def imported(self) -> list[StoredModel]:
        """Return the models from elsewhere that wait to be tried."""
        return self._read(ModelRow.state == "imported")

    def get(self, kind: ModelKind, subject: str, version: int) -> StoredModel:
        """Return one model.

        Raises:
            NoSuchModelError: it is not there, or not any more.
        """
        with Session(self._engine) as session:
            row = session.scalar(_of(kind, subject).where(ModelRow.version == version))
            found = None if row is None else _stored(row)
        if found is None:
            raise NoSuchModelError(f"version: found {version}; allowed: {self._versions(kind, subject)}")
        return found

    def models(self) -> list[StoredModel]:
        """Return all models, by kind and subject, newest first."""
        return self._read()

    def before(self, model: StoredModel) -> Message:
        """Return the model that ``model`` replaced; as configured where there was none, or it is gone."""
        if model.replaced:
            try:
                return self.get(model.kind, model.subject, model.replaced).model
            except NoSuchModelError:
                pass
        return as_configured(model.kind, model.subject, model.decided)

    def history(self, most: int = 200) -> list[Activation]:
        """Return the latest decisions, newest first."""
        with Session(self._engine) as session:
            told = session.scalars(select(DecisionRow.told).order_by(DecisionRow.id.desc()).limit(most)).all()
        return [_decision.decode(line) for line in told]

    # -- decisions, one transaction each -----------------------------------------------------------------------------

    def activate(self, model: Message, kind: ModelKind, subject: str, area: str, how: Decided) -> StoredModel:
        """Make a model live, in the place of the one that was."""
        return self._activate(model, kind, subject, area, how, "activated", probation=True)

    def refuse(self, model: Message, kind: ModelKind, subject: str, area: str, how: Decided) -> StoredModel:
        """Write down a model that does not go live."""
        with Session(self._engine) as session, session.begin():
            row = _new_row(session, model, kind, subject, area, "refused", how)
            _decide(session, row, "refused", how)
            _let_go(session, kind, subject)
            return _known(row)

    def take_in_all(
        self, models: Sequence[tuple[Message, ModelKind, str, str]], how: Sequence[Decided]
    ) -> list[StoredModel]:
        """Write down models from elsewhere, (message, kind, subject, area) each, all of them or none; none is live."""
        with Session(self._engine) as session, session.begin():
            rows = []
            for (model, kind, subject, area), why in zip(models, how, strict=True):
                # One at a time waits to be tried: the newer takes the place of an older one.
                waiting = (*_which(kind, subject), ModelRow.state == "imported")
                session.execute(delete(ModelRow).where(*waiting))
                rows.append(_new_row(session, model, kind, subject, area, "imported", why))
                _decide(session, rows[-1], "imported", why)
                _let_go(session, kind, subject)
            return [_known(row) for row in rows]

    def judged(self, model: StoredModel, how: Decided) -> None:
        """Write down that an imported model was refused by the gate."""
        with Session(self._engine) as session, session.begin():
            row = session.scalar(_of(model.kind, model.subject).where(ModelRow.version == model.version))
            if row is not None:
                row.state, row.reason, row.decided = "refused", how.reason, how.t
                _decide(session, row, "refused", how)

    def promote(self, model: StoredModel, how: Decided) -> StoredModel:
        """Make a model live that is stored already, as a new version."""
        return self._activate(
            model.model, model.kind, model.subject, model.area, how, "activated", probation=how.by == "learning",
            origin=model.version,
        )  # fmt: skip

    def roll_back(self, kind: ModelKind, subject: str, how: Decided) -> StoredModel:
        """Return to the model before the one that is live, as a new version.

        Raises:
            NoSuchModelError: nothing is live but what is configured.
        """
        current = self.active(kind, subject)
        if current is None:
            raise NoSuchModelError(
                f"subject: no {kind} model of {subject!r} is active; allowed: {self._subjects(kind)}"
            )
        former = self.before(current)
        return self._activate(
            former, kind, subject, current.area, how, "rolled back", probation=False, back_to=current.replaced
        )

    def settle(self, kind: ModelKind, subject: str) -> None:
        """End the probation of the live model: it has stood it."""
        with Session(self._engine) as session, session.begin():
            row = _active(session, kind, subject)
            if row is not None:
                row.probation = False

    def _activate(
        self,
        model: Message,
        kind: ModelKind,
        subject: str,
        area: str,
        how: Decided,
        decision: Literal["activated", "rolled back"],
        *,
        probation: bool,
        origin: int | None = None,
        back_to: int | None = None,
    ) -> StoredModel:
        """Make a model live as a new version.

        Args:
            model: what is published; numbered here.
            kind: of model.
            subject: of what.
            area: whose fusion tries it.
            how: why and when.
            decision: what the history calls it.
            probation: whether it will be held against the one before.
            origin: version of the row the model is taken from, which goes.
            back_to: the version it is again; what that one replaced is what it replaces.
        """
        with Session(self._engine) as session, session.begin():
            before = _active(session, kind, subject)
            replaced = 0 if before is None else before.version
            if before is not None:
                before.state = "superseded" if decision == "activated" else "rolled back"
                before.probation = False
                if decision == "rolled back":
                    before.reason = how.reason
            if back_to is not None:
                again = session.scalar(_of(kind, subject).where(ModelRow.version == back_to))
                replaced = 0 if again is None else again.replaced
            if origin is not None:
                session.execute(delete(ModelRow).where(*_which(kind, subject), ModelRow.version == origin))
            row = _new_row(session, model, kind, subject, area, "active", how)
            row.replaced, row.probation = replaced, probation
            _decide(session, row, decision, how)
            _let_go(session, kind, subject)
            return _known(row)

    # -- what learners know, switches, erasure -----------------------------------------------------------------------

    def save_states(self, states: Mapping[str, bytes], t: float) -> None:
        """Keep what the learners know, by name, in the place of what was kept; only what changed is written."""
        digests = {name: hashlib.blake2b(state, digest_size=16).digest() for name, state in states.items()}
        changed = {name for name, digest in digests.items() if self._digests.get(name) != digest}
        same = sorted(states.keys() - changed)
        if not changed and digests.keys() == self._digests.keys():
            return
        with Session(self._engine) as session, session.begin():
            session.execute(delete(LearnerRow).where(LearnerRow.name.not_in(same)))
            session.add_all(LearnerRow(name=name, saved=t, state=states[name]) for name in sorted(changed))
        self._digests = digests

    def states(self) -> dict[str, bytes]:
        """Return what the learners knew when they were saved."""
        with Session(self._engine) as session:
            return {row.name: row.state for row in session.scalars(select(LearnerRow))}

    @property
    def frozen(self) -> bool:
        """Whether an operator has switched activation off."""
        with Session(self._engine) as session:
            row = session.get(SwitchRow, "frozen")
            return row is not None and row.enabled

    def freeze(self, frozen: bool) -> None:
        """Switch activation off or on again, over restarts."""
        with Session(self._engine) as session, session.begin():
            session.merge(SwitchRow(name="frozen", enabled=frozen))

    def forget(self, device: str) -> None:
        """Delete all that is of one phone, decisions included."""
        with Session(self._engine) as session, session.begin():
            session.execute(delete(ModelRow).where(ModelRow.kind.in_(PERSONAL), ModelRow.subject == device))
            session.execute(delete(DecisionRow).where(DecisionRow.kind.in_(PERSONAL), DecisionRow.subject == device))

    def _read(self, *which: Any) -> list[StoredModel]:
        order = (ModelRow.kind, ModelRow.subject, ModelRow.version.desc())
        with Session(self._engine) as session:
            rows = session.scalars(select(ModelRow).where(*which).order_by(*order)).all()
            return [model for row in rows if (model := _stored(row)) is not None]

    def _versions(self, kind: ModelKind, subject: str) -> str:
        with Session(self._engine) as session:
            rows = session.scalars(_of(kind, subject).order_by(ModelRow.version)).all()
            return ", ".join(str(row.version) for row in rows) or f"none, there is no {kind} model of {subject!r}"

    def _subjects(self, kind: ModelKind) -> str:
        return ", ".join(sorted({model.subject for model in self.all_active() if model.kind == kind})) or "none now"


def _which(kind: ModelKind, subject: str) -> tuple[Any, ...]:
    return ModelRow.kind == kind, ModelRow.subject == subject


def _of(kind: ModelKind, subject: str) -> Any:
    return select(ModelRow).where(*_which(kind, subject))


def _active(session: Session, kind: ModelKind, subject: str) -> ModelRow | None:
    row: ModelRow | None = session.scalar(_of(kind, subject).where(ModelRow.state == "active"))
    return row


def _new_row(
    session: Session, model: Message, kind: ModelKind, subject: str, area: str, state: ModelState, how: Decided
) -> ModelRow:
    last = session.scalar(select(func.max(ModelRow.version)).where(*_which(kind, subject))) or 0
    row = ModelRow(
        kind=kind,
        subject=subject,
        area=area,
        version=last + 1,
        state=state,
        payload=encode(numbered(model, last + 1, how.t, how.reason)),
        decided=how.t,
        since=how.since,
        replaced=0,
        probation=False,
        reason=how.reason,
        evidence=msgspec.json.encode(_finite(how.evidence)).decode(),
    )
    session.add(row)
    session.flush()
    return row


def _decide(session: Session, row: ModelRow, decision: Any, how: Decided) -> None:
    told = Activation(
        t=how.t,
        kind=row.kind,  # type: ignore[arg-type]
        subject=row.subject,
        version=row.version,
        decision=decision,
        reason=how.reason,
        # Learners' numbers are often NumPy's, which JSON does not know.
        gain=None if how.gain is None else float(how.gain),
        margin=None if how.margin is None else float(how.margin),
        evidence=_finite(how.evidence),
        by=how.by,
    )
    session.add(DecisionRow(kind=row.kind, subject=row.subject, told=msgspec.json.encode(told).decode()))
    session.flush()
    newest = session.scalar(select(func.max(DecisionRow.id))) or 0
    session.execute(delete(DecisionRow).where(DecisionRow.id <= newest - KEPT_DECISIONS))


def _let_go(session: Session, kind: ModelKind, subject: str) -> None:
    """Delete old rows, but never the live one, the one it replaced, or the newest, whose version counts on."""
    rows = session.scalars(_of(kind, subject).order_by(ModelRow.version.desc())).all()
    live = next((row for row in rows if row.state == "active"), None)
    held = {rows[0].version} | (set() if live is None else {live.version, live.replaced})
    refused = [row for row in rows if row.state == "refused"]
    old = {row.id for row in rows[KEPT_MODELS:]} | {row.id for row in refused[KEPT_REFUSED:]}
    for row in rows:
        if row.id in old and row.version not in held:
            session.delete(row)


def _known(row: ModelRow) -> StoredModel:
    stored = _stored(row)
    assert stored is not None  # noqa: S101 (just encoded)
    return stored


def _stored(row: ModelRow) -> StoredModel | None:
    if row.state not in get_args(ModelState):
        return None
    try:
        model = read_model(row.kind, row.payload)  # type: ignore[arg-type]
        evidence = msgspec.json.decode(row.evidence, type=dict[str, float])
    except (MessageError, KeyError, msgspec.DecodeError):
        return None
    return StoredModel(
        kind=row.kind,  # type: ignore[arg-type]
        subject=row.subject,
        area=row.area,
        version=row.version,
        state=row.state,  # type: ignore[arg-type]
        model=model,
        decided=row.decided,
        since=row.since,
        replaced=row.replaced,
        probation=row.probation,
        reason=row.reason,
        evidence=evidence,
    )


def _finite(evidence: Mapping[str, float]) -> dict[str, float]:
    return {name: float(value) for name, value in evidence.items() if math.isfinite(value)}
