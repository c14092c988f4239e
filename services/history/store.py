"""Into the database: entries of the spool, a whole file of it in one transaction, each exactly once."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Engine, case, delete, false, select, text, update
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.exc import DataError, IntegrityError

from services.history.blocks import COLUMNS, MOST_POINTS, decode, encode, merge
from services.history.entries import AlertTold, Counted, Entry, Forgotten, Points, Replaced
from services.history.persons import carried_by
from services.history.tables import AlertRow, AppliedRow, BlockRow, ErasedRow, OccupancyRow
from shared.messages import encode as encode_message

__all__ = [
    "Applied",
    "Key",
    "Store",
    "add_points",
    "erased_among",
    "find_blocks",
    "forget",
    "put_blocks",
    "take_turn",
    "upsert",
]

Key = tuple[str, str, int, str, str]
"""Of a block: kind, subject, minute, area, floor."""
ROWS_AT_ONCE = 500
"""Of a statement: databases limit how many values one may carry."""

_UNFIT = (DataError, IntegrityError, ValueError, OverflowError)
"""What a database says of values it cannot hold."""


class Applied(msgspec.Struct):
    """What became of a file of the spool."""

    entries: int = 0
    refused: list[str] = []
    """Why entries were left out, one line each."""
    forgotten: list[str] = []
    """Devices of which nothing is stored any more."""


class Store:
    """History's writer.

    Args:
        engine: an open database with the tables.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def apply(self, name: str, entries: Sequence[Entry], present: Collection[str]) -> Applied:
        """Bring a file of the spool in, all of it or nothing; one that is in already is left alone.

        An entry that the database refuses for what it holds is left out: it must not stop all others for ever.

        Args:
            name: of the file.
            entries: what it holds.
            present: the names of all files there are; of others the database need not know.

        Raises:
            SQLAlchemyError: the database is away.
        """
        try:
            return self._apply(name, entries, present, apart=False)
        except _UNFIT:
            return self._apply(name, entries, present, apart=True)

    def erased(self) -> list[str]:
        """Return the devices of which nothing may be stored, the latest last."""
        with self._engine.connect() as connection:
            return list(connection.scalars(select(ErasedRow.device).order_by(ErasedRow.t)))

    def _apply(self, name: str, entries: Sequence[Entry], present: Collection[str], apart: bool) -> Applied:
        done = Applied()
        with self._engine.begin() as connection:
            take_turn(connection)
            known = set(connection.scalars(select(AppliedRow.name)))
            if gone := known - set(present):
                connection.execute(delete(AppliedRow).where(AppliedRow.name.in_(gone)))
            if name in known:
                done.forgotten = [entry.device for entry in entries if isinstance(entry, Forgotten)]
                return done
            connection.execute(upsert(connection, AppliedRow, [{"name": name}], ["name"], []))
            for group in ([entry] for entry in entries) if apart else _grouped(entries):
                if not apart:
                    self._take(connection, group, done)
                    continue
                try:
                    with connection.begin_nested():
                        self._take(connection, group, done)
                except _UNFIT as error:
                    done.refused.append(str(error).partition("\n")[0])
        return done

    def _take(self, connection: Connection, group: Sequence[Entry], done: Applied) -> None:
        """Bring in entries of one kind."""
        first = group[0]
        if isinstance(first, Points):
            add_points(connection, [entry for entry in group if isinstance(entry, Points)])
        elif isinstance(first, Counted):
            _count(connection, [entry for entry in group if isinstance(entry, Counted)])
        elif isinstance(first, AlertTold):
            _tell(connection, [entry for entry in group if isinstance(entry, AlertTold)])
        elif isinstance(first, Replaced):
            for entry in group:
                if isinstance(entry, Replaced):
                    _replace(connection, entry)
        else:
            for entry in group:
                if isinstance(entry, Forgotten):
                    forget(connection, entry.device, entry.t)
                    done.forgotten.append(entry.device)
        done.entries += len(group)


def take_turn(connection: Connection) -> None:
    """Wait until nobody else writes positions or erasures, and let nobody until this transaction ends.

    An import would otherwise bring in who is erased at that moment, unseen by either.
    """
    if connection.dialect.name == "postgresql":
        connection.execute(text(f"LOCK TABLE {ErasedRow.__tablename__} IN SHARE ROW EXCLUSIVE MODE"))
    else:
        connection.execute(delete(ErasedRow).where(false()))  # SQLite: the first statement that writes takes the lock


def upsert(
    connection: Connection, table: Any, rows: Sequence[dict[str, Any]], keys: Sequence[str], changed: Sequence[str]
) -> Any:
    """Return a statement that inserts rows, or sets ``changed`` of those whose ``keys`` are there already."""
    insert = (postgresql if connection.dialect.name == "postgresql" else sqlite).insert(table).values(list(rows))
    if not changed:
        return insert.on_conflict_do_nothing(index_elements=list(keys))
    return insert.on_conflict_do_update(
        index_elements=list(keys), set_={name: getattr(insert.excluded, name) for name in changed}
    )


def add_points(connection: Connection, told: Sequence[Points]) -> None:
    """Merge points into the blocks of their minutes; of one subject and moment the latest told counts."""
    erased = erased_among(connection, {name for points in told if points.kind == "device" for name in points.subject})
    new: dict[Key, list[tuple[int, ...]]] = {}
    steps: dict[Key, float] = {}
    for points in told:
        for row, subject in enumerate(points.subject):
            if points.kind == "device" and subject in erased:
                continue
            minute, ms = divmod(round(points.t[row] * 1000.0), 60_000)
            key = (points.kind, subject, minute, points.area, points.floor[row])
            new.setdefault(key, []).append(
                (
                    ms,
                    round(points.x[row] * 100.0),
                    round(points.y[row] * 100.0),
                    round(points.accuracy[row] * 100.0),
                    round(points.probability[row] * 1000.0),
                    points.track[row],
                    points.state[row],
                )
            )
            steps[key] = points.step
    found = find_blocks(connection, new)
    none = np.empty((len(COLUMNS), 0), np.int32)
    blocks = {
        key: merge(found.get(key, none), np.array(rows, np.int32).T)[:, :MOST_POINTS] for key, rows in new.items()
    }
    put_blocks(connection, blocks, steps)


def find_blocks(connection: Connection, keys: Collection[Key]) -> dict[Key, NDArray[np.int32]]:
    """Return those of the blocks that are stored, unpacked."""
    found: dict[Key, bytes] = {}
    for kind in {key[0] for key in keys}:
        subjects = sorted({key[1] for key in keys if key[0] == kind})
        minutes = sorted({key[2] for key in keys if key[0] == kind})
        for part in _parts(subjects):
            asked = (
                select(BlockRow)
                .where(BlockRow.kind == kind, BlockRow.subject.in_(part))
                .where(BlockRow.minute.in_(minutes))
            )
            for row in connection.execute(asked):
                key = (row.kind, row.subject, row.minute, row.area, row.floor)
                if key in keys:
                    found[key] = row.points
    counts, values = decode(list(found.values()))
    return dict(zip(found, np.split(values, np.cumsum(counts)[:-1], axis=1), strict=True)) if found else {}


def put_blocks(connection: Connection, blocks: dict[Key, NDArray[np.int32]], steps: dict[Key, float]) -> None:
    """Store blocks in place of those of the same keys."""
    rows = [
        {
            "kind": kind,
            "subject": subject,
            "minute": minute,
            "area": area,
            "floor": floor,
            "step": steps[kind, subject, minute, area, floor],
            "points": encode(block),
            "tracks": carried_by(block) if kind == "device" else "",
        }
        for (kind, subject, minute, area, floor), block in blocks.items()
    ]
    keys = ["kind", "subject", "minute", "area", "floor"]
    for part in _parts(rows):
        connection.execute(upsert(connection, BlockRow, part, keys, ["step", "points", "tracks"]))


def _replace(connection: Connection, told: Replaced) -> None:
    """Take out what was said of devices in the span of a revision, and put in what it says."""
    for device, since in zip(told.device, told.since, strict=True):
        rows = connection.execute(
            select(BlockRow)
            .where(BlockRow.kind == "device", BlockRow.subject == device, BlockRow.area == told.area)
            .where(BlockRow.minute.between(math.floor(since / 60.0), math.floor(told.until / 60.0)))
        ).all()
        for row in rows:
            _, block = decode([row.points])
            t = row.minute * 60_000 + block[0].astype(np.int64)
            kept = (t < round(since * 1000.0)) | (t > round(told.until * 1000.0))
            if kept.all():
                continue
            if kept.any():
                left = block[:, kept]
                values = {"points": encode(left), "tracks": carried_by(left)}
                connection.execute(update(BlockRow).where(BlockRow.id == row.id).values(**values))
            else:
                connection.execute(delete(BlockRow).where(BlockRow.id == row.id))
    add_points(connection, [told.points])


def _tell(connection: Connection, told: Sequence[AlertTold]) -> None:
    named = {name for entry in told for name in (entry.alert.device, entry.alert.other_device) if name is not None}
    erased = erased_among(connection, named)
    rows = {}
    for entry in told:
        alert = entry.alert
        bare = msgspec.structs.replace(alert, device=None, other_device=None)
        rows[alert.id] = {
            "id": alert.id,
            "t": alert.t,
            "zone": alert.zone,
            "kind": alert.kind,
            "device": None if alert.device in erased else alert.device,
            "other_device": None if alert.other_device in erased else alert.other_device,
            "told": encode_message(bare).decode(),
        }
    for part in _parts(list(rows.values())):
        connection.execute(upsert(connection, AlertRow, part, ["id"], []))


def _count(connection: Connection, told: Sequence[Counted]) -> None:
    """Add counts to those of their minutes."""
    sums: dict[tuple[str, str, int], list[int]] = {}
    for counted in told:
        minute = math.floor(counted.t / 60.0)
        for place, people, phones in zip(counted.place, counted.people, counted.phones, strict=True):
            found = sums.setdefault((counted.kind, place, minute), [0, 0, 0, 0])
            found[0] += 1
            found[1] += people
            found[2] = max(found[2], people)
            found[3] += phones
    rows = [
        {"kind": kind, "place": place, "minute": minute, "counts": n, "people": people, "most": most, "phones": phones}
        for (kind, place, minute), (n, people, most, phones) in sums.items()
    ]
    for part in _parts(rows):
        connection.execute(_added(connection, part))


def _added(connection: Connection, rows: Sequence[dict[str, Any]]) -> Any:
    insert = (postgresql if connection.dialect.name == "postgresql" else sqlite).insert(OccupancyRow).values(list(rows))
    table, more = OccupancyRow, insert.excluded
    greatest = case((table.most > more.most, table.most), else_=more.most)
    return insert.on_conflict_do_update(
        index_elements=["kind", "place", "minute"],
        set_={
            "counts": table.counts + more.counts,
            "people": table.people + more.people,
            "most": greatest,
            "phones": table.phones + more.phones,
        },
    )


def forget(connection: Connection, device: str, t: float) -> None:
    """Take a device out of everything, for good; ``t``: when its consent was withdrawn."""
    connection.execute(upsert(connection, ErasedRow, [{"device": device, "t": t}], ["device"], []))
    connection.execute(delete(BlockRow).where(BlockRow.kind == "device", BlockRow.subject == device))
    connection.execute(update(AlertRow).where(AlertRow.device == device).values(device=None))
    connection.execute(update(AlertRow).where(AlertRow.other_device == device).values(other_device=None))


def erased_among(connection: Connection, names: Iterable[str]) -> set[str]:
    """Return those of the devices of which nothing may be stored."""
    found: set[str] = set()
    for part in _parts(sorted(names)):
        found.update(connection.scalars(select(ErasedRow.device).where(ErasedRow.device.in_(part))))
    return found


def _grouped(entries: Sequence[Entry]) -> list[list[Entry]]:
    """Return runs of entries that can go in together; the order of what changes what stays."""
    groups: list[list[Entry]] = []
    free: dict[type[Entry], list[Entry]] = {}
    for entry in entries:
        kind = type(entry)
        if kind in (Replaced, Forgotten):
            free.clear()
        if kind not in free:
            free[kind] = []
            groups.append(free[kind])
        free[kind].append(entry)
    return groups


def _parts(rows: Sequence[Any]) -> Iterable[Sequence[Any]]:
    for start in range(0, len(rows), ROWS_AT_ONCE):
        yield rows[start : start + ROWS_AT_ONCE]
