"""Decisions as they are told: page by page, newest first."""

from __future__ import annotations

import msgspec
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.learning.activation.kinds import PERSONAL
from services.learning.activation.tables import DecisionRow
from shared.learning_report import Activation, ModelKind

__all__ = ["page"]

_decoder = msgspec.json.Decoder(Activation)


def page(
    session: Session, kind: ModelKind | None, subject: str | None, before: float | None, most: int, *, personal: bool
) -> tuple[list[Activation], bool]:
    """Return decisions, newest first, and whether there are older ones; never half of those of one moment.

    Args:
        session: on learning's database.
        kind: only of models of this kind; None: of all.
        subject: only of this area, camera or device; None: of all.
        before: only older ones, seconds since the epoch; None: the newest.
        most: at most so many, and the rest of the last one's moment.
        personal: whether also of models of people's phones.
    """
    wanted = select(DecisionRow.told).order_by(DecisionRow.id.desc())
    if kind is not None:
        wanted = wanted.where(DecisionRow.kind == kind)
    if subject is not None:
        wanted = wanted.where(DecisionRow.subject == subject)
    if not personal:
        wanted = wanted.where(DecisionRow.kind.not_in(PERSONAL))
    found: list[Activation] = []
    for line in session.scalars(wanted.execution_options(yield_per=100)):
        one = _read(line)
        if one is None or (before is not None and one.t >= before):
            continue
        if len(found) >= most and one.t != found[-1].t:
            return found, True
        found.append(one)
    return found, False


def _read(line: str) -> Activation | None:
    """Return a decision; None where it cannot be read any more: a newer program knew more kinds."""
    try:
        return _decoder.decode(line)
    except msgspec.DecodeError:
        return None
