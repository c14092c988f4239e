"""Webhooks as rows, and for each the alerts it has yet to be sent: what is written survives a restart."""

from __future__ import annotations

import secrets
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
from sqlalchemy import Engine, delete, func, select, update
from sqlalchemy.orm import Session

from services.api.alerts.signature import new_secret
from services.api.alerts.tables import LONGEST_ID, LONGEST_REASON, AlertRow, DeliveryRow, WebhookRow
from services.api.alerts.webhook_replies import DeadLetter, NewWebhook, Webhook, WebhookDefinition
from shared.messages import Alert

__all__ = ["Due", "TooManyError", "WebhookStore"]

_alert = msgspec.json.Decoder(Alert)


class TooManyError(Exception):
    """There are as many webhooks as may be."""


@dataclass(frozen=True, slots=True)
class Due:
    """One message to be sent now; ``attempts`` were made before."""

    delivery: int
    webhook: str
    url: str
    secret: str
    attempts: int
    alert: Alert


class WebhookStore:
    """The webhooks of one site. Any thread may use it.

    Args:
        engine: an open database with the tables.
        most: webhooks at once.
        most_waiting: alerts that wait for one webhook; while more come the new ones are dead at once. As many dead
            letters are kept.
        dead_seconds: how long dead letters are kept.
    """

    def __init__(self, engine: Engine, most: int, most_waiting: int, dead_seconds: float) -> None:
        self._engine = engine
        self._most, self._most_waiting, self._dead_seconds = most, most_waiting, dead_seconds

    def enqueue(self, session: Session, alerts: Sequence[AlertRow]) -> None:
        """Write down, in the transaction that writes the alerts, whom they are to be sent to.

        What is written after a webhook was made is news to it; clocks, which may be set back, are not asked.
        """
        if not alerts:
            return
        now = time.time()
        for webhook in session.scalars(select(WebhookRow).where(WebhookRow.enabled)):
            kinds, zones = msgspec.json.decode(webhook.kinds), msgspec.json.decode(webhook.zones)
            room = self._most_waiting - _count(session, webhook.id, dead=False)
            for alert in alerts:
                if (kinds and alert.kind not in kinds) or (zones and alert.zone not in zones):
                    continue
                dead = room <= 0
                room -= 1
                reason = f"more than {self._most_waiting} alerts were waiting" if dead else ""
                row = DeliveryRow(webhook=webhook.id, alert=alert.seq, dead=dead, attempts=0, due=now, reason=reason)
                session.add(row)

    # -- what staff do ---------------------------------------------------------------------------------------------

    def create(self, definition: WebhookDefinition, by: str, now: float) -> NewWebhook:
        """Make a webhook.

        Raises:
            TooManyError: there are too many.
        """
        secret = new_secret()
        with Session(self._engine) as session, session.begin():
            if (session.scalar(select(func.count()).select_from(WebhookRow)) or 0) >= self._most:
                raise TooManyError(f"there are {self._most} webhooks, as many as may be")
            row = WebhookRow(
                id="wh-" + secrets.token_hex(8),
                secret=secret,
                created=now,
                created_by=by[:LONGEST_ID],
                delivered=0,
                failed=0,
                last_reason="",
                **_columns(definition),
            )
            session.add(row)
            session.flush()
            return NewWebhook(secret=secret, **msgspec.structs.asdict(_told(session, row)))

    def all(self) -> list[Webhook]:
        """Return all webhooks, first made first."""
        with Session(self._engine) as session:
            rows = session.scalars(select(WebhookRow).order_by(WebhookRow.created, WebhookRow.id))
            return [_told(session, row) for row in rows]

    def one(self, webhook: str) -> Webhook:
        """Return one webhook.

        Raises:
            KeyError: there is none such.
        """
        with Session(self._engine) as session:
            return _told(session, _held(session, webhook))

    def change(self, webhook: str, definition: WebhookDefinition) -> Webhook:
        """Change a webhook; its secret stays.

        Raises:
            KeyError: there is none such.
        """
        with Session(self._engine) as session, session.begin():
            row = _held(session, webhook)
            for name, value in _columns(definition).items():
                setattr(row, name, value)
            return _told(session, row)

    def delete(self, webhook: str) -> None:
        """Delete a webhook with all that waits for it.

        Raises:
            KeyError: there is none such.
        """
        with Session(self._engine) as session, session.begin():
            session.delete(_held(session, webhook))

    def dead(self, webhook: str, after: int, limit: int) -> list[DeadLetter]:
        """Return the dead letters of a webhook behind the one ``after``, oldest first.

        Raises:
            KeyError: there is no such webhook.
        """
        with Session(self._engine) as session:
            _held(session, webhook)
            found = session.execute(
                select(DeliveryRow, AlertRow)
                .join(AlertRow, AlertRow.seq == DeliveryRow.alert)
                .where(DeliveryRow.webhook == webhook, DeliveryRow.dead, DeliveryRow.id > after)
                .order_by(DeliveryRow.id)
                .limit(limit)
            )
            return [
                DeadLetter(
                    id=row.id, alert=_alert.decode(alert.told), attempts=row.attempts, died=row.due, reason=row.reason
                )
                for row, alert in found
            ]

    def replay(self, webhook: str, letter: int | None, now: float) -> int:
        """Send dead letters again, one or all, oldest first, as many as may still wait; return how many.

        Raises:
            KeyError: there is no such webhook.
        """
        with Session(self._engine) as session, session.begin():
            _held(session, webhook)
            which = [DeliveryRow.webhook == webhook, DeliveryRow.dead]
            if letter is not None:
                which.append(DeliveryRow.id == letter)
            room = max(0, self._most_waiting - _count(session, webhook, dead=False))
            found = list(session.scalars(select(DeliveryRow).where(*which).order_by(DeliveryRow.id).limit(room)))
            for row in found:
                row.dead, row.attempts, row.due = False, 0, now
            return len(found)

    # -- what the sender does --------------------------------------------------------------------------------------

    def due(self, now: float, room: dict[str, int], each: int, under_way: set[int]) -> list[Due]:
        """Return what is to be sent now.

        Args:
            now: wall clock.
            room: how many more each webhook may be sent at once, where that is not ``each``.
            each: of all others.
            under_way: deliveries that are being sent.
        """
        found: list[Due] = []
        ready_for = select(DeliveryRow.id).where(
            DeliveryRow.webhook == WebhookRow.id, DeliveryRow.dead.is_(False), DeliveryRow.due <= now
        )
        with Session(self._engine) as session:
            for webhook in session.scalars(select(WebhookRow).where(WebhookRow.enabled, ready_for.exists())).all():
                most = room.get(webhook.id, each)
                if most <= 0:
                    continue
                rows = session.execute(
                    select(DeliveryRow, AlertRow.told)
                    .join(AlertRow, AlertRow.seq == DeliveryRow.alert)
                    .where(DeliveryRow.webhook == webhook.id, DeliveryRow.dead.is_(False), DeliveryRow.due <= now)
                    .order_by(DeliveryRow.due, DeliveryRow.id)
                    .limit(most + each)
                )
                ready = [(row, told) for row, told in rows if row.id not in under_way]
                found += [
                    Due(row.id, webhook.id, webhook.url, webhook.secret, row.attempts, _alert.decode(told))
                    for row, told in ready[:most]
                ]
        return found

    def waiting(self) -> int:
        """Return how many deliveries wait."""
        with Session(self._engine) as session:
            return session.scalar(select(func.count()).select_from(DeliveryRow).where(DeliveryRow.dead.is_(False))) or 0

    def delivered(self, due: Due, now: float) -> None:
        """A receiver took it."""
        with Session(self._engine) as session, session.begin():
            session.execute(delete(DeliveryRow).where(DeliveryRow.id == due.delivery))
            session.execute(
                update(WebhookRow)
                .where(WebhookRow.id == due.webhook)
                .values(delivered=WebhookRow.delivered + 1, last_success=now)
            )

    def failed(self, due: Due, now: float, reason: str, again: float | None) -> None:
        """A receiver did not take it: try at ``again``, or give it up."""
        reason = "".join(c if c.isprintable() else " " for c in reason)[:LONGEST_REASON]
        with Session(self._engine) as session, session.begin():
            session.execute(
                update(DeliveryRow)
                .where(DeliveryRow.id == due.delivery)
                .values(
                    attempts=due.attempts + 1, reason=reason, dead=again is None, due=now if again is None else again
                )
            )
            session.execute(
                update(WebhookRow)
                .where(WebhookRow.id == due.webhook)
                .values(failed=WebhookRow.failed + 1, last_failure=now, last_reason=reason)
            )

    def forget(self, now: float) -> None:
        """Delete dead letters that are too old, and of each webhook those beyond as many as may wait for it."""
        with Session(self._engine) as session, session.begin():
            session.execute(delete(DeliveryRow).where(DeliveryRow.dead, DeliveryRow.due < now - self._dead_seconds))
            for webhook in session.scalars(select(WebhookRow.id)).all():
                dead = select(DeliveryRow.id).where(DeliveryRow.webhook == webhook, DeliveryRow.dead)
                first = session.scalar(dead.order_by(DeliveryRow.id.desc()).offset(self._most_waiting).limit(1))
                if first is not None:
                    which = (DeliveryRow.webhook == webhook, DeliveryRow.dead, DeliveryRow.id <= first)
                    session.execute(delete(DeliveryRow).where(*which))


def _columns(definition: WebhookDefinition) -> dict[str, Any]:
    return {
        "name": definition.name,
        "url": definition.url,
        "kinds": msgspec.json.encode(definition.kinds).decode(),
        "zones": msgspec.json.encode(definition.zones).decode(),
        "enabled": definition.enabled,
    }


def _held(session: Session, webhook: str) -> WebhookRow:
    row = session.get(WebhookRow, webhook)
    if row is None:
        raise KeyError(webhook)
    return row


def _count(session: Session, webhook: str, dead: bool) -> int:
    which = (
        select(func.count()).select_from(DeliveryRow).where(DeliveryRow.webhook == webhook, DeliveryRow.dead == dead)
    )
    return session.scalar(which) or 0


def _told(session: Session, row: WebhookRow) -> Webhook:
    return Webhook(
        id=row.id,
        url=row.url,
        name=row.name,
        kinds=msgspec.json.decode(row.kinds),
        zones=msgspec.json.decode(row.zones),
        enabled=row.enabled,
        created=row.created,
        created_by=row.created_by,
        waiting=_count(session, row.id, dead=False),
        dead=_count(session, row.id, dead=True),
        delivered=row.delivered,
        failed=row.failed,
        last_success=row.last_success,
        last_failure=row.last_failure,
        last_reason=row.last_reason,
    )
