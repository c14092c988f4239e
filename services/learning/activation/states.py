"""What learners know, as it is kept over a restart: one row by the name of each."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping

from sqlalchemy import Engine, delete, select
from sqlalchemy.orm import Session

from services.learning.activation.tables import LearnerRow

__all__ = ["LearnerStates"]


class LearnerStates:
    """The states of one site's learners. Used by one thread.

    Args:
        engine: an open database with learning's tables.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._digests: dict[str, bytes] | None = None
        """Of the states that are stored, by name, empty where it is not known; None: nothing was saved yet."""

    def save(self, states: Mapping[str, bytes], t: float, untouched: Collection[str] = ()) -> None:
        """Keep states by name, in the place of all that was kept; only what changed is written.

        Args:
            states: by name.
            t: wall clock, seconds since the epoch.
            untouched: names whose rows stay as they are, if there are any.
        """
        before = self._digests or {}
        digests = {name: hashlib.blake2b(state, digest_size=16).digest() for name, state in states.items()}
        digests |= {name: before.get(name, b"") for name in untouched}
        changed = {name for name in states if before.get(name) != digests[name]}
        if not changed and self._digests is not None and digests.keys() == self._digests.keys():
            return
        stay = sorted({*states, *untouched} - changed)
        with Session(self._engine) as session, session.begin():
            session.execute(delete(LearnerRow).where(LearnerRow.name.not_in(stay)))
            session.add_all(LearnerRow(name=name, saved=t, state=states[name]) for name in sorted(changed))
        self._digests = digests

    def read(self) -> dict[str, bytes]:
        """Return the states that were saved, by name."""
        with Session(self._engine) as session:
            return {row.name: row.state for row in session.scalars(select(LearnerRow))}
