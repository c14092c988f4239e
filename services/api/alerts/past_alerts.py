"""Alerts that streams told before the event log begins: who comes back after long, or after a restart, misses none."""

from __future__ import annotations

import msgspec
from sqlalchemy import Engine
from starlette.concurrency import run_in_threadpool

from services.api.alerts.inbox import AlertInbox
from services.api.database_away import database_away
from services.api.event_log import Entry

__all__ = ["PastAlerts"]

MOST = 10_000
"""Alerts told to one who comes back."""


class PastAlerts:
    """Events made again from the inbox, for the HTTP event loop.

    Args:
        engine: the database, for what is said when it is away.
        inbox: the alerts.
    """

    def __init__(self, engine: Engine, inbox: AlertInbox) -> None:
        self._engine = engine
        self._inbox = inbox

    async def between(self, after: int, before: int) -> list[Entry] | None:
        """Return the events of alerts after event ``after`` and before event ``before``; None: too many to tell."""

        def read() -> list[Entry] | None:
            with database_away(self._engine):
                found = self._inbox.told_between(after, before, MOST + 1)
            if len(found) > MOST:
                return None
            return [
                Entry(
                    told.event,
                    "alert",
                    told.alert.id,
                    told.alert.area,
                    told.alert.zone,
                    msgspec.json.encode(told.alert),
                )
                for told in found
            ]

        return await run_in_threadpool(read)

    async def event_of(self, alert: str) -> int | None:
        """Return the event that told an alert, None where it is not held (any more)."""

        def read() -> int | None:
            with database_away(self._engine):
                return self._inbox.event_of(alert) if alert.isprintable() else None

        return await run_in_threadpool(read)
