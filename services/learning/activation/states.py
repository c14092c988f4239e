"""What learners know, as it is kept over a restart: one row by the name of each.

Only rows of names that this process has are written or deleted. Others stay: of areas it does not learn of now, and
what was set aside because its learner did not understand it. They go after ``KEPT`` seconds, or whole as soon as
somebody withdraws whose phone they name, since nobody is there who could forget that one alone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping

from sqlalchemy import Engine, delete, select
from sqlalchemy.orm import Session

from services.learning.activation.tables import LearnerRow

__all__ = ["ASIDE", "KEPT", "LearnerStates"]

ASIDE = "aside/"
"""Before the name of who did not understand it."""
KEPT = 30.0 * 86400.0
"""Seconds for which what nobody uses is kept: as long as the gateway tells who withdrew meanwhile."""


class LearnerStates:
    """The states of one site's learners. Used by one thread.

    Args:
        engine: an open database with learning's tables.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._digests: dict[str, bytes] = {}
        """Of the states that are stored, by name; none of those it is not known of."""

    def save(self, states: Mapping[str, bytes], t: float, gone: Collection[str] = ()) -> None:
        """Keep states by name; only what changed is written.

        Args:
            states: by name.
            t: wall clock, seconds since the epoch.
            gone: names whose rows go.
        """
        digests = {name: hashlib.blake2b(state, digest_size=16).digest() for name, state in states.items()}
        changed = sorted(name for name, digest in digests.items() if self._digests.get(name) != digest)
        if not changed and not gone:
            return
        with Session(self._engine) as session, session.begin():
            session.execute(delete(LearnerRow).where(LearnerRow.name.in_([*changed, *gone])))
            session.add_all(LearnerRow(name=name, saved=t, state=states[name]) for name in changed)
        self._digests |= digests
        for name in gone:
            self._digests.pop(name, None)

    def read(self) -> dict[str, bytes]:
        """Return the states that were saved, by name."""
        with Session(self._engine) as session:
            return {row.name: row.state for row in session.scalars(select(LearnerRow))}

    def set_aside(self, name: str, *, back: bool) -> None:
        """Set a state aside that is not understood; ``back``: in its place what was set aside before is used again."""
        with Session(self._engine) as session, session.begin():
            row, former = (session.get(LearnerRow, key) for key in (name, ASIDE + name))
            if row is not None and former is not None:
                row.saved, row.state, former.saved, former.state = former.saved, former.state, row.saved, row.state
                if not back:
                    session.delete(row)
            elif row is not None:
                row.name = ASIDE + name
            elif former is not None and back:
                former.name = name
        self._digests.pop(name, None)

    def let_go(self, mine: Collection[str], before: float) -> None:
        """Delete the rows of names that are not ``mine`` and were saved before that time."""
        with Session(self._engine) as session, session.begin():
            session.execute(delete(LearnerRow).where(LearnerRow.name.not_in(mine), LearnerRow.saved < before))

    def forget(self, device: str, mine: Collection[str]) -> None:
        """Delete the rows of names that are not ``mine`` and name a phone."""
        with Session(self._engine) as session, session.begin():
            for name in session.scalars(select(LearnerRow.name).where(LearnerRow.name.not_in(mine))).all():
                row = session.get_one(LearnerRow, name)
                if device.encode() in row.state:
                    session.delete(row)
