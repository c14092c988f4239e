"""How a model becomes a row and is read back, how a decision is written down, and which old rows go."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import msgspec
from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session

from services.learning.activation.kinds import numbered, read_model
from services.learning.activation.tables import DecisionRow, ModelRow
from shared.learning_report import Activation, ModelKind
from shared.messages import Message, MessageError, encode

__all__ = [
    "KEPT_MODELS",
    "Decided",
    "ModelState",
    "StoredModel",
    "Went",
    "active_row",
    "known",
    "let_go",
    "make_live",
    "new_row",
    "read_row",
    "rows_of",
    "which",
    "write_decision",
]

ModelState = Literal["imported", "active", "superseded", "refused", "rolled back"]
By = Literal["learning", "operator"]
Went = Literal["activated", "rolled back"]
KEPT_MODELS = 12
"""Rows of one kind and subject, besides the active one and the one it replaced …"""
KEPT_REFUSED = 3
"""… of them refused ones: large, and of no use but to see why."""
KEPT_DECISIONS = 2000


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


def which(kind: ModelKind, subject: str) -> tuple[Any, ...]:
    """Return the conditions for the rows of a kind and subject."""
    return ModelRow.kind == kind, ModelRow.subject == subject


def rows_of(kind: ModelKind, subject: str) -> Any:
    """Return a query for the rows of a kind and subject."""
    return select(ModelRow).where(*which(kind, subject))


def active_row(session: Session, kind: ModelKind, subject: str) -> ModelRow | None:
    """Return the row that is live; None: as configured."""
    row: ModelRow | None = session.scalar(rows_of(kind, subject).where(ModelRow.state == "active"))
    return row


def new_row(
    session: Session, model: Message, kind: ModelKind, subject: str, area: str, state: ModelState, how: Decided
) -> ModelRow:
    """Add a model as the next version of its kind and subject."""
    last = session.scalar(select(func.max(ModelRow.version)).where(*which(kind, subject))) or 0
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


def make_live(
    session: Session,
    model: Message,
    kind: ModelKind,
    subject: str,
    area: str,
    how: Decided,
    decision: Went,
    *,
    probation: bool,
    origin: int | None = None,
    replaced: int | None = None,
) -> ModelRow:
    """Make a model live as a new version.

    Args:
        session: within a transaction.
        model: what is published; numbered here.
        kind: of model.
        subject: of what.
        area: whose fusion tries it.
        how: why and when.
        decision: what the history calls it.
        probation: whether it will be held against the one before.
        origin: version of the row the model is taken from, which goes.
        replaced: the version a next roll-back leads to; None: the one that is live.
    """
    before = active_row(session, kind, subject)
    if before is not None:
        before.state = "superseded" if decision == "activated" else "rolled back"
        before.probation = False
        if decision == "rolled back":
            before.reason = how.reason
    if replaced is None:
        replaced = 0 if before is None else before.version
    if origin is not None:
        session.execute(delete(ModelRow).where(*which(kind, subject), ModelRow.version == origin))
    row = new_row(session, model, kind, subject, area, "active", how)
    row.replaced, row.probation = replaced, probation
    write_decision(session, row, decision, how)
    let_go(session, kind, subject)
    return row


def write_decision(session: Session, row: ModelRow, decision: Any, how: Decided) -> None:
    """Add a decision to the history, and let the oldest go."""
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


def let_go(session: Session, kind: ModelKind, subject: str) -> None:
    """Delete old rows, but never the live one, the one it replaced, or the newest, whose version counts on."""
    rows = session.scalars(rows_of(kind, subject).order_by(ModelRow.version.desc())).all()
    live = next((row for row in rows if row.state == "active"), None)
    held = {rows[0].version} | (set() if live is None else {live.version, live.replaced})
    refused = [row for row in rows if row.state == "refused"]
    old = {row.id for row in rows[KEPT_MODELS:]} | {row.id for row in refused[KEPT_REFUSED:]}
    for row in rows:
        if row.id in old and row.version not in held:
            session.delete(row)


def known(row: ModelRow) -> StoredModel:
    """Return the model of a row that was read or written just now."""
    stored = read_row(row)
    assert stored is not None  # noqa: S101 (just encoded)
    return stored


def read_row(row: ModelRow) -> StoredModel | None:
    """Return the model of a row; None where it cannot be read any more."""
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
