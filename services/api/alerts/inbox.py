"""Alerts as rows: told once each, in the order they came, until acknowledged, erased or too old."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec
from sqlalchemy import CursorResult, Engine, Select, delete, exists, func, or_, select, tuple_, update
from sqlalchemy.orm import Session

from services.api.alerts.alert_replies import Acknowledgement, InboxAlert
from services.api.alerts.tables import LONGEST_ID, AlertRow, DeliveryRow
from shared.messages import Alert

__all__ = ["FORGOTTEN", "AcknowledgedError", "AlertInbox", "Told", "Wanted"]

OnNew = Callable[[Session, Sequence[AlertRow]], None]

_alert = msgspec.json.Decoder(Alert)

FORGOTTEN = "it waited until the inbox no longer held it"
"""Why such an alert is a dead letter."""


class AcknowledgedError(Exception):
    """Somebody was first; ``first`` says who."""

    def __init__(self, first: Acknowledgement) -> None:
        super().__init__(f"acknowledged by {first.by} before")
        self.first = first


@dataclass(frozen=True, slots=True)
class Wanted:
    """Which alerts: those that match whatever is not None; ``since`` and ``until`` by time of measurement, s."""

    since: float | None = None
    until: float | None = None
    zone: str | None = None
    area: str | None = None
    device: str | None = None
    kinds: tuple[str, ...] = ()
    acknowledged: bool | None = None


@dataclass(frozen=True, slots=True)
class Told:
    """An alert, when it was sent (wall clock), and the id of the event that told it."""

    alert: Alert
    sent: float
    event: int


class AlertInbox:
    """The alerts of one site. Any thread may read; one writes.

    Args:
        engine: an open database with the tables.
        most: alerts kept, those that came first go first.
        seconds: how long they are kept.
        on_new: called with alerts that were just written, in the same transaction.
    """

    def __init__(self, engine: Engine, most: int, seconds: float, on_new: OnNew = lambda _session, _rows: None) -> None:
        self._engine = engine
        self._most, self._seconds = most, seconds
        self._on_new = on_new

    def add(self, alerts: Sequence[Told]) -> None:
        """Write alerts in this order; what is known is left out."""
        if not alerts:
            return
        fresh = {told.alert.id: told for told in alerts}
        with Session(self._engine) as session, session.begin():
            known = set(session.scalars(select(AlertRow.id).where(AlertRow.id.in_(fresh))))
            rows = [_row(told) for name, told in fresh.items() if name not in known]
            session.add_all(rows)
            session.flush()
            self._on_new(session, rows)

    def newest_ids(self, most: int) -> list[str]:
        """Return the ids of the alerts that came last, oldest first."""
        with Session(self._engine) as session:
            return list(session.scalars(select(AlertRow.id).order_by(AlertRow.seq.desc()).limit(most)))[::-1]

    def has_zone(self, zone: str) -> bool:
        """Whether any alert is of this zone."""
        with Session(self._engine) as session:
            return session.scalar(select(AlertRow.seq).where(AlertRow.zone == zone).limit(1)) is not None

    def newest(self, wanted: Wanted, limit: int, before: str | None = None) -> list[InboxAlert]:
        """Return matching alerts, measured last first, those that come after alert ``before`` in that order.

        Raises:
            KeyError: no alert ``before`` is held (any more).
        """
        order = tuple_(AlertRow.t, AlertRow.seq)
        with Session(self._engine) as session:
            asked = _matching(wanted).order_by(AlertRow.t.desc(), AlertRow.seq.desc())
            if before is not None:
                last = _held(session, before)
                asked = asked.where(order < tuple_(last.t, last.seq))
            return [_told(row) for row in session.scalars(asked.limit(limit))]

    def arrived(self, wanted: Wanted, limit: int, after: str) -> list[InboxAlert]:
        """Return matching alerts in the order they came, after the one named; empty: from the first.

        Raises:
            KeyError: no alert ``after`` is held (any more).
        """
        with Session(self._engine) as session:
            asked = _matching(wanted).order_by(AlertRow.seq)
            if after:
                asked = asked.where(AlertRow.seq > _held(session, after).seq)
            return [_told(row) for row in session.scalars(asked.limit(limit))]

    def told_between(self, after: int, before: int, limit: int) -> list[Told]:
        """Return the alerts that streams told after event ``after`` and before event ``before``, first told first."""
        with Session(self._engine) as session:
            asked = select(AlertRow).where(AlertRow.event > after, AlertRow.event < before).order_by(AlertRow.event)
            return [Told(_alert.decode(row.told), row.sent, row.event) for row in session.scalars(asked.limit(limit))]

    def event_of(self, alert_id: str) -> int | None:
        """Return the event that told an alert, None where it is not held (any more)."""
        with Session(self._engine) as session:
            return session.scalar(select(AlertRow.event).where(AlertRow.id == alert_id))

    def one(self, alert_id: str) -> InboxAlert:
        """Return one alert.

        Raises:
            KeyError: it is not held (any more).
        """
        with Session(self._engine) as session:
            return _told(_held(session, alert_id))

    def acknowledge(self, alert_id: str, by: str, note: str, now: float) -> InboxAlert:
        """Note who has looked at an alert; the first one counts.

        Raises:
            KeyError: the alert is not held (any more).
            AcknowledgedError: somebody did before.
        """
        with Session(self._engine) as session, session.begin():
            # One statement looks and writes: of two who come at once, one finds nothing left to do.
            written: CursorResult[tuple[()]] = session.execute(  # type: ignore[assignment]
                update(AlertRow)
                .where(AlertRow.id == alert_id, AlertRow.acknowledged.is_(None))
                .values(acknowledged=now, acknowledged_by=by[:LONGEST_ID], note=note)
            )
            seen = _told(_held(session, alert_id))
            if written.rowcount == 0 and seen.acknowledged is not None:
                raise AcknowledgedError(seen.acknowledged)
            return seen

    def erase(self, device: str, without: Callable[[str], str]) -> None:
        """Take a device whose consent was withdrawn out of all alerts; ``without`` takes it out of staff's notes."""
        # Two questions, for each of which there is an index.
        about = or_(AlertRow.device == device, AlertRow.other_device == device)
        noted = (AlertRow.note != "") & AlertRow.note.contains(device, autoescape=True)
        with Session(self._engine) as session, session.begin():
            for row in {row for asked in (about, noted) for row in session.scalars(select(AlertRow).where(asked))}:
                gone = {name: None for name in ("device", "other_device") if getattr(row, name) == device}
                row.told = msgspec.json.encode(msgspec.structs.replace(_alert.decode(row.told), **gone))
                for name in gone:
                    setattr(row, name, None)
                row.note = without(row.note)

    def forget(self, now: float) -> None:
        """Delete what is too old or too much; what a webhook has yet to take of that is a dead letter from then on.

        The alert of a dead letter is held as long as that.
        """
        with Session(self._engine) as session, session.begin():
            newest = session.scalar(select(func.max(AlertRow.seq))) or 0
            gone = or_(AlertRow.sent < now - self._seconds, AlertRow.seq <= newest - self._most)
            waiting = DeliveryRow.dead.is_(False) & DeliveryRow.alert.in_(select(AlertRow.seq).where(gone))
            session.execute(update(DeliveryRow).where(waiting).values(dead=True, due=now, reason=FORGOTTEN))
            sent = ~exists().where(DeliveryRow.alert == AlertRow.seq)
            session.execute(delete(AlertRow).where(gone, sent).execution_options(synchronize_session=False))


def _matching(wanted: Wanted) -> Select[AlertRow]:
    asked = select(AlertRow)
    if wanted.since is not None:
        asked = asked.where(AlertRow.t > wanted.since)
    if wanted.until is not None:
        asked = asked.where(AlertRow.t <= wanted.until)
    if wanted.zone is not None:
        asked = asked.where(AlertRow.zone == wanted.zone)
    if wanted.area is not None:
        asked = asked.where(AlertRow.area == wanted.area)
    if wanted.device is not None:
        asked = asked.where(or_(AlertRow.device == wanted.device, AlertRow.other_device == wanted.device))
    if wanted.kinds:
        asked = asked.where(AlertRow.kind.in_(wanted.kinds))
    if wanted.acknowledged is not None:
        asked = asked.where(AlertRow.acknowledged.is_not(None) == wanted.acknowledged)
    return asked


def _held(session: Session, alert_id: str) -> AlertRow:
    row = session.scalar(select(AlertRow).where(AlertRow.id == alert_id))
    if row is None:
        raise KeyError(alert_id)
    return row


def _row(told: Told) -> AlertRow:
    alert = told.alert
    return AlertRow(
        id=alert.id,
        t=alert.t,
        sent=told.sent,
        event=told.event,
        zone=alert.zone,
        kind=alert.kind,
        area=alert.area,
        device=alert.device,
        other_device=alert.other_device,
        told=msgspec.json.encode(alert),
        acknowledged=None,
        acknowledged_by="",
        note="",
    )


def _told(row: AlertRow) -> InboxAlert:
    alert = _alert.decode(row.told)
    seen = None
    if row.acknowledged is not None:
        seen = Acknowledgement(by=row.acknowledged_by, at=row.acknowledged, note=row.note)
    return InboxAlert(**msgspec.structs.asdict(alert), acknowledged=seen)
