"""A list of definitions that staff edit: in memory for readers, in the database for good, published when it changes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import msgspec
from sqlalchemy import CursorResult, Engine, delete, insert, select, update
from sqlalchemy.exc import SQLAlchemyError

from services.api.admin.conditions import check_match, etag_of
from services.api.admin.tables import CatalogueRow, DefinitionRow
from services.api.database_away import database_away
from services.api.problems import Problem, ProblemError, unknown
from shared.database import unreachable
from shared.runner import ServiceError

__all__ = ["Catalogue", "Entry"]


class Definition(Protocol):
    """What a catalogue holds: a Struct with an id."""

    @property
    def id(self) -> str:
        """Which one."""


D = TypeVar("D", bound=Definition)


@dataclass(frozen=True, slots=True)
class Entry(Generic[D]):
    """One definition, its tag, its place in the list."""

    definition: D
    etag: str
    place: int


class Catalogue(Generic[D]):
    """The definitions of one kind. Readers take ``entries``, which is never changed but replaced as a whole.

    As long as nobody has changed anything there is nothing in the database, and what the site file says holds; with
    the first change all of it moves to the database, and the site file no longer counts.

    Args:
        engine: the database.
        kind: ``zone`` or ``exhibit``.
        shape: the Struct.
        beginning: what holds until the first change.
        most: as many are kept.
        publish: called with version and definitions after each change, and at the start where there was one.
        clean: returns a definition as it may be kept, the same where nothing is wrong: without erased devices.
        check: called with all definitions before and after a change; refuses it by raising a ``ProblemError``.

    Raises:
        ServiceError: the database cannot be read.
    """

    def __init__(
        self,
        engine: Engine,
        kind: str,
        shape: type[D],
        beginning: Sequence[D],
        most: int,
        publish: Callable[[int, list[D]], None] = lambda version, definitions: None,
        clean: Callable[[D], D] = lambda definition: definition,
        check: Callable[[list[D], list[D]], None] = lambda before, after: None,
    ) -> None:
        self._engine = engine
        self._kind = kind
        self._shape = shape
        self._beginning = list(beginning)
        self._most = most
        self._publish = publish
        self._clean = clean
        self._check = check
        self._lock = threading.Lock()
        self.version = 0
        self.entries: dict[str, Entry[D]] = {}
        try:
            self._load()
        except SQLAlchemyError as error:
            raise ServiceError(unreachable(engine, error)) from error
        if self.version:
            publish(self.version, self.definitions)

    @property
    def definitions(self) -> list[D]:
        """All of them, in their order."""
        return [entry.definition for entry in self.entries.values()]

    def find(self, name: str) -> Entry[D]:
        """Return one.

        Raises:
            ProblemError: there is none of that id.
        """
        entry = self.entries.get(name)
        if entry is None:
            raise unknown(self._kind, name)
        return entry

    def add(self, definitions: Sequence[D]) -> list[Entry[D]]:
        """Add all of these or none.

        Raises:
            ProblemError: an id is taken, there would be too many, or the database is away.
        """
        with self._lock:
            if len(self.entries) + len(definitions) > self._most:
                raise self._refusal(
                    409, "full", "Too many", f"there are {len(self.entries)}; allowed: {self._most} of a kind", "body"
                )
            taken = set(self.entries)
            for definition in definitions:
                if definition.id in taken:
                    words = f"there is a {self._kind} of that id"
                    raise self._refusal(409, "id-taken", "Id taken", words, "id", definition.id)
                taken.add(definition.id)
            place = max((entry.place for entry in self.entries.values()), default=-1) + 1
            added = [_entry(self._clean(definition), place + n) for n, definition in enumerate(definitions)]
            self._store({**self.entries, **{entry.definition.id: entry for entry in added}}, added, [])
            return added

    def replace(self, name: str, definition: D, if_match: str | None) -> tuple[Entry[D], Entry[D]]:
        """Put ``definition`` in the place of the one called ``name`` and return what was there and what is now.

        Raises:
            ProblemError: there is none of that id, it was changed meanwhile, or the database is away.
        """
        with self._lock:
            before = self.find(name)
            check_match(if_match, before.etag)
            entry = _entry(self._clean(definition), before.place)
            self._store(self.entries | {name: entry}, [entry], [name])
            return before, entry

    def remove(self, name: str, if_match: str | None) -> Entry[D]:
        """Take one out and return what it was.

        Raises:
            ProblemError: there is none of that id, it was changed meanwhile, or the database is away.
        """
        with self._lock:
            before = self.find(name)
            check_match(if_match, before.etag)
            self._store({key: entry for key, entry in self.entries.items() if key != name}, [], [name])
            return before

    def clean(self) -> None:
        """Keep all of them as they may be kept now.

        Raises:
            ProblemError: the database is away.
        """
        with self._lock:
            cleaned = {
                name: _entry(kept, entry.place)
                for name, entry in self.entries.items()
                if (kept := self._clean(entry.definition)) is not entry.definition
            }
            if cleaned:
                self._store(self.entries | cleaned, list(cleaned.values()), list(cleaned))

    def _load(self) -> None:
        with self._engine.connect() as connection:
            version = connection.scalar(select(CatalogueRow.version).where(CatalogueRow.kind == self._kind))
            rows = connection.execute(
                select(DefinitionRow.place, DefinitionRow.body)
                .where(DefinitionRow.kind == self._kind)
                .order_by(DefinitionRow.place)
            ).all()
        self.version = version or 0
        if version is None:
            found = [_entry(definition, place) for place, definition in enumerate(self._beginning)]
        else:
            found = [_entry(msgspec.json.decode(body, type=self._shape), place) for place, body in rows]
        self.entries = {entry.definition.id: entry for entry in found}

    def _store(self, entries: dict[str, Entry[D]], written: list[Entry[D]], removed: list[str]) -> None:
        """Write the change, then let readers see it. Versions count seconds: they grow over a lost database too."""
        self._check(self.definitions, [entry.definition for entry in entries.values()])
        version = max(self.version + 1, int(time.time()))
        if not self.version:
            written, removed = list(entries.values()), []
        of_kind = DefinitionRow.kind == self._kind
        with database_away(self._engine), self._engine.begin() as connection:
            if self.version:
                held = (CatalogueRow.kind == self._kind) & (CatalogueRow.version == self.version)
                changed: CursorResult[tuple[()]] = connection.execute(
                    update(CatalogueRow).where(held).values(version=version)
                )
                if changed.rowcount != 1:
                    raise self._refusal(409, "changed-elsewhere", "Changed elsewhere", _ELSEWHERE, None)
            else:
                connection.execute(insert(CatalogueRow).values(kind=self._kind, version=version))
            if removed:
                connection.execute(delete(DefinitionRow).where(of_kind & DefinitionRow.id.in_(removed)))
            if written:
                connection.execute(insert(DefinitionRow), [self._row(entry) for entry in written])
        self.version, self.entries = version, entries
        self._publish(version, self.definitions)

    def _row(self, entry: Entry[D]) -> dict[str, object]:
        body = msgspec.json.encode(entry.definition).decode()
        return {"kind": self._kind, "id": entry.definition.id, "place": entry.place, "body": body}

    def _refusal(
        self, status: int, kind: str, title: str, detail: str, field: str | None, found: str | None = None
    ) -> ProblemError:
        detail = f"{self._kind}: {detail}"
        return ProblemError(
            Problem(type=f"urn:atrium:{kind}", title=title, status=status, detail=detail, field=field, found=found)
        )


_ELSEWHERE = "another process of the API changed the database; one alone may: restart this one"


def _entry(definition: D, place: int) -> Entry[D]:
    return Entry(definition, etag_of(msgspec.json.encode(definition)), place)
