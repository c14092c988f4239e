"""What is too old goes, what is old gets thinner; a little at a time, so that writing never waits for it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Engine, delete, or_, select, update

from services.history.blocks import decode, encode
from services.history.store import take_turn
from services.history.tables import AlertRow, BlockRow, OccupancyRow

__all__ = ["Retention", "Tidying", "thinned"]

AT_ONCE = 2000
"""Blocks of one transaction."""
EVERY = 600.0
"""Seconds between two looks once nothing is left to do."""


@dataclass(frozen=True, slots=True)
class Retention:
    """Seconds for which what is kept; ``coarse``: between positions that are older than ``detail``.

    An alert that is kept for longer than ``phones`` loses the names in it then.
    """

    phones: float
    people: float
    detail: float
    coarse: float
    alerts: float
    counts: float


def thinned(block: NDArray[np.int32], step: float) -> NDArray[np.int32]:
    """Return the first point of every ``step`` seconds of a block."""
    _, first = np.unique(block[0] // round(step * 1000.0), return_index=True)
    return np.ascontiguousarray(block[:, first])


class Tidying:
    """Carries retention out, one portion a call.

    Args:
        engine: of history's database.
        retention: what is kept for how long.
    """

    def __init__(self, engine: Engine, retention: Retention) -> None:
        self._engine = engine
        self._retention = retention
        self._next = 0.0

    def work(self, now: float) -> int:
        """Do a portion, if it is time for one; returns how many rows went or got thinner.

        Raises:
            SQLAlchemyError: the database is away.
        """
        if now < self._next <= now + EVERY:  # a clock that was set back must not put it off for long
            return 0
        done = self._delete(now) or self._thin(now)
        self._next = 0.0 if done else now + EVERY
        return done

    def _delete(self, now: float) -> int:
        keep = self._retention
        done = 0
        with self._engine.begin() as connection:
            for kind, seconds in (("device", keep.phones), ("track", keep.people)):
                old = (
                    select(BlockRow.id)
                    .where(BlockRow.kind == kind, BlockRow.minute < math.floor((now - seconds) / 60.0))
                    .limit(AT_ONCE)
                )
                done += connection.execute(delete(BlockRow).where(BlockRow.id.in_(old))).rowcount
            done += connection.execute(delete(AlertRow).where(AlertRow.t < now - keep.alerts)).rowcount
            named = or_(AlertRow.device.is_not(None), AlertRow.other_device.is_not(None))
            old_names = update(AlertRow).where(AlertRow.t < now - keep.phones, named)
            done += connection.execute(old_names.values(device=None, other_device=None)).rowcount
            too_old = math.floor((now - keep.counts) / 60.0)
            done += connection.execute(delete(OccupancyRow).where(OccupancyRow.minute < too_old)).rowcount
        return done

    def _thin(self, now: float) -> int:
        keep = self._retention
        before = math.floor((now - keep.detail) / 60.0)
        done = 0
        with self._engine.begin() as connection:
            take_turn(connection)
            for kind in ("device", "track"):
                rows = connection.execute(
                    select(BlockRow.id, BlockRow.points)
                    .where(BlockRow.kind == kind, BlockRow.minute < before, BlockRow.step < keep.coarse)
                    .limit(AT_ONCE)
                ).all()
                for row in rows:
                    _, block = decode([row.points])
                    values = {"points": encode(thinned(block, keep.coarse)), "step": keep.coarse}
                    connection.execute(update(BlockRow).where(BlockRow.id == row.id).values(**values))
                done += len(rows)
        return done
