"""Which ids may events have? None that was told before: not after a restart, nor where the clock was set back.

Ids are reserved in the database in blocks, ahead of those that are told: a process that is killed leaves a gap.
"""

from __future__ import annotations

from sqlalchemy import Engine, func, select
from sqlalchemy.orm import Session

from services.api.alerts.tables import AlertRow, EventNumberRow

__all__ = ["BLOCK", "EventNumbers"]

BLOCK = 10**9
"""Ids reserved at once: weeks of a busy site."""


class EventNumbers:
    """The ids of the events of one process.

    Args:
        engine: the database, which can be reached now.
        now: wall clock, s: where no id was told yet they begin at its microseconds.
    """

    def __init__(self, engine: Engine, now: float) -> None:
        self._engine = engine
        with Session(engine) as session:
            held = session.get(EventNumberRow, 1)
            told = max(held.reserved if held else 0, session.scalar(select(func.max(AlertRow.event))) or 0)
        self.first = max(told + 1, int(now * 1e6))
        self._reserve(self.first)

    def keep(self, newest: int) -> None:
        """Have ids in reserve, ``newest`` having been told.

        Raises:
            SQLAlchemyError: the database is away; half a block is left.
        """
        if newest > self._reserved - BLOCK // 2:
            self._reserve(newest)

    def _reserve(self, after: int) -> None:
        with Session(self._engine) as session, session.begin():
            session.merge(EventNumberRow(id=1, reserved=after + BLOCK))
        self._reserved = after + BLOCK
