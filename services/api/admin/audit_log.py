"""Who changed what, and who looked whom up: written before or as it is answered, kept for a while, read by few.

Changes and pictures are one row each, at once. Look-ups of the same by the same within a minute (reads of everybody:
within an hour) are one row with a count, written within a second: a guide app asks for its visitor every second of an
afternoon.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import Engine, delete, insert, or_, select, update

from services.api.admin.tables import AuditRow
from services.api.problems import Problem, ProblemError
from services.api.pseudonyms import Pseudonyms

__all__ = ["HOUR", "MINUTE", "AuditLog", "Deed"]

MINUTE = 60.0
HOUR = 3600.0
MOST_OPEN = 50_000
"""Look-ups that are counted apart now."""
MOST_OF_ONE = 5000
"""Of one key or person: nobody can use up what others need."""
FEW = 8
"""Devices the database is asked for by name; of more all rows are read once."""
_TEXTS = (AuditRow.subject, AuditRow.detail)


@dataclass(frozen=True)
class Deed:
    """Who did what to what, and how it was answered."""

    who: str
    action: str
    subject: str
    status: int
    detail: str = ""


@dataclass
class _Open:
    since: float
    account: str = ""
    times: int = 0
    row: int | None = None
    written: int = 0


class AuditLog:
    """The audit log of one site; every method may be called from any thread.

    Args:
        engine: the database.
        days: after which a row is forgotten.
        pseudonyms: of erased devices.
        clock: wall clock.
    """

    def __init__(
        self, engine: Engine, days: float, pseudonyms: Pseudonyms, clock: Callable[[], float] = time.time
    ) -> None:
        self._engine = engine
        self._pseudonyms = pseudonyms
        self._kept = 86400.0 * days
        self._clock = clock
        self._lock = threading.Lock()
        self._writing = threading.Lock()
        self._open: dict[tuple[Deed, float, int], _Open] = {}
        """By deed, seconds that are one row, and which of them."""
        self._of: Counter[str] = Counter()
        """How many of these are of an account."""
        self._swept = 0.0

    def record(self, deed: Deed) -> None:
        """Write one row now.

        Raises:
            SQLAlchemyError: the database is away.
        """
        with self._writing, self._engine.begin() as connection:
            connection.execute(insert(AuditRow).values(_row(self._plain(deed), self._clock(), 1)))

    def look_up(self, deed: Deed, account: str = "", span: float = MINUTE) -> None:
        """Count one look-up, to be written soon.

        Args:
            deed: the look-up.
            account: whose it is, for the bound of one.
            span: seconds within which the same is one row.

        Raises:
            ProblemError: this account looks too many up, or too many wait to be written because the database is away:
                nobody is to be looked up unseen.
        """
        with self._lock:
            now = self._clock()
            key = (self._plain(deed), span, int(now // span))
            held = self._open.get(key)
            if held is None:
                if self._of[account] >= MOST_OF_ONE:
                    raise _too_many(429, "too many different look-ups within a minute", math.ceil(MINUTE))
                if len(self._open) >= MOST_OPEN:
                    raise _too_many(503, "look-ups cannot be written down now, so nobody is looked up", 5)
                held = self._open[key] = _Open(now, account)
                self._of[account] += 1
            held.times += 1

    def ended(self, deed: Deed) -> None:
        """Note that a stream has ended whose opening was ``deed``; there are no more of these than were opened."""
        with self._lock:
            now = self._clock()
            key = (replace(self._plain(deed), detail="ended"), MINUTE, int(now // MINUTE))
            self._open.setdefault(key, _Open(now)).times += 1

    def keep(self) -> None:
        """Write what waits and forget what is old; called about once a second.

        Raises:
            SQLAlchemyError: the database is away; what waits goes on waiting.
        """
        now = self._clock()
        with self._writing:
            with self._lock:
                waiting = [
                    (deed, held, held.times) for (deed, *_), held in self._open.items() if held.times > held.written
                ]
            with self._engine.begin() as connection:
                for deed, held, times in waiting:
                    if held.row is None:
                        made = connection.execute(insert(AuditRow).values(_row(deed, held.since, times)))
                        held.row = made.inserted_primary_key[0] if made.inserted_primary_key else None
                    else:
                        connection.execute(update(AuditRow).where(AuditRow.id == held.row).values(times=times))
                if now - self._swept > HOUR:
                    connection.execute(delete(AuditRow).where(AuditRow.t < now - self._kept))
                    self._swept = now
            with self._lock:
                for _, held, times in waiting:
                    held.written = times
                self._open = {
                    key: held
                    for key, held in self._open.items()
                    if held.times > held.written or key[2] == int(now // key[1])
                }
                self._of = Counter(held.account for held in self._open.values())

    def erase(self, devices: Collection[str]) -> None:
        """Write the pseudonyms of erased devices in the place of their ids: who did what, and when, stays.

        Raises:
            SQLAlchemyError: the database is away.
        """
        with self._lock:
            plain: dict[tuple[Deed, float, int], _Open] = {}
            for (deed, span, number), held in self._open.items():
                key = self._plain(deed), span, number
                if key in plain:  # a look-up by the pseudonym already: two rows become one
                    held.times += plain[key].times - plain[key].written
                plain[key] = held
            self._open = plain
        self.keep()
        named = select(AuditRow.id, AuditRow.subject, AuditRow.detail)
        if len(devices) <= FEW:
            named = named.where(
                or_(*(column.contains(device, autoescape=True) for column in _TEXTS for device in devices))
            )
        without = self._pseudonyms.without
        with self._writing, self._engine.begin() as connection:
            changed = [
                (row.id, {"subject": without(row.subject), "detail": without(row.detail)})
                for row in connection.execute(named.execution_options(yield_per=1000))
                if without(row.subject) != row.subject or without(row.detail) != row.detail
            ]
            for number, texts in changed:
                connection.execute(update(AuditRow).where(AuditRow.id == number).values(**texts))

    def _plain(self, deed: Deed) -> Deed:
        """Return it without ids of erased devices."""
        subject, detail = self._pseudonyms.without(deed.subject), self._pseudonyms.without(deed.detail)
        same = subject == deed.subject and detail == deed.detail
        return deed if same else replace(deed, subject=subject, detail=detail)

    def read(
        self,
        before: int | None,
        since: float | None,
        until: float | None,
        who: str | None,
        action: str | None,
        limit: int,
    ) -> list[dict[str, Any]]:
        """Return the newest rows that match, newest first.

        Raises:
            SQLAlchemyError: the database is away.
        """
        wanted = select(AuditRow.__table__).order_by(AuditRow.id.desc()).limit(limit)
        for column, value in ((AuditRow.who, who), (AuditRow.action, action)):
            if value is not None:
                wanted = wanted.where(column == value)
        if before is not None:
            wanted = wanted.where(AuditRow.id < before)
        if since is not None:
            wanted = wanted.where(AuditRow.t > since)
        if until is not None:
            wanted = wanted.where(AuditRow.t <= until)
        with self._engine.connect() as connection:
            return [dict(row) for row in connection.execute(wanted).mappings()]


def _row(deed: Deed, t: float, times: int) -> dict[str, object]:
    return {
        "t": t,
        "who": _plain(deed.who, 128),
        "action": _plain(deed.action, 16),
        "subject": _plain(deed.subject, 512),
        "status": deed.status,
        "times": times,
        "detail": _plain(deed.detail, 20_000),
    }


def _too_many(status: int, words: str, seconds: int) -> ProblemError:
    problem = Problem(type="urn:atrium:audit-full", title="Audit log full", status=status, detail=words)
    return ProblemError(problem, {"Retry-After": str(seconds)})


def _plain(text: str, most: int) -> str:
    """No database takes a zero character, and what is read in a table should be readable."""
    return "".join(letter if letter.isprintable() else "�" for letter in text)[:most]
