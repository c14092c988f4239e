"""All that is kept, or all of one device, as a file: a backup, a move to another database, an answer to a visitor.

Lines of JSON in gzip: what the file is, then rows, last how many there were, so that a file cut off is known for one.
"""

from __future__ import annotations

import gzip
import math
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from sqlalchemy import Connection, Engine, Select, or_, select

from services.history.blocks import BlockError, check, decode, merge
from services.history.sampling import LATEST, plausible
from services.history.store import Key, erased_among, find_blocks, forget, put_blocks, take_turn, upsert
from services.history.tables import AlertRow, BlockRow, ErasedRow, OccupancyRow
from shared.history_query import STATES
from shared.keys import is_identifier
from shared.messages import Alert, MessageError
from shared.messages import decode as decode_message

__all__ = ["TransferError", "export_history", "import_history"]

FORMAT = "atrium-history/1"
AT_ONCE = 2000
"""Rows in memory together."""
LONGEST_LINE = 4 * 2**20


class TransferError(ValueError):
    """A file that cannot be brought in: the text names line, field, value and what is allowed."""


class _Header(msgspec.Struct, tag="header"):
    format: str
    since: float | None = None
    until: float | None = None
    device: str | None = None


class _Erased(msgspec.Struct, tag="erased"):
    device: str
    t: float


class _Block(msgspec.Struct, tag="block"):
    kind: Literal["track", "device"]
    subject: str
    minute: int
    area: str
    floor: str
    step: float
    points: bytes


class _Alert(msgspec.Struct, tag="alert"):
    id: str
    device: str | None
    other_device: str | None
    told: str


class _Occupancy(msgspec.Struct, tag="occupancy"):
    kind: Literal["zone", "area"]
    place: str
    minute: int
    counts: int
    people: int
    most: int
    phones: int


class _End(msgspec.Struct, tag="end"):
    rows: int


_Line = _Header | _Erased | _Block | _Alert | _Occupancy | _End
_decoder: msgspec.json.Decoder[_Line] = msgspec.json.Decoder(_Line)


def export_history(
    engine: Engine, out: Path, since: float | None = None, until: float | None = None, device: str | None = None
) -> int:
    """Write what is kept into a file and return how many rows; the file is there whole or not at all.

    Args:
        engine: of history's database.
        out: the file.
        since: only what was measured from this time on, to the minute.
        until: only what was measured before this time, to the minute.
        device: only what bears the name of this device.

    Raises:
        OSError: the file cannot be written.
        SQLAlchemyError: the database cannot be read.
    """
    part = out.with_name(out.name + ".part")
    rows = 0
    try:
        with gzip.open(part, "wb", compresslevel=5) as file:
            for line in _lines(engine, since, until, device):
                file.write(msgspec.json.encode(line) + b"\n")
                rows += not isinstance(line, _Header)
            file.write(msgspec.json.encode(_End(rows=rows)) + b"\n")
        part.replace(out)
    finally:
        part.unlink(missing_ok=True)
    return rows


def import_history(engine: Engine, source: Path) -> int:
    """Bring a file in, all of it or nothing, and return how many rows; what is there already is not doubled.

    Who is erased here, or in the file, stays so.

    Raises:
        TransferError: the file is none of ours, cut off, or holds what cannot be.
        OSError: it cannot be read.
        SQLAlchemyError: the database cannot be written.
    """
    rows = 0
    with engine.begin() as connection:
        take_turn(connection)
        waiting: list[_Block] = []
        for number, line in _read(source):
            if isinstance(line, _Block):
                waiting.append(_checked_block(line, number))
                if len(waiting) >= AT_ONCE:
                    _put_blocks(connection, waiting)
                    waiting = []
            else:
                _put(connection, line, number)
            rows += 1
        _put_blocks(connection, waiting)
    return rows


def _lines(engine: Engine, since: float | None, until: float | None, device: str | None) -> Iterator[_Line]:
    first = -(2**53) if since is None else math.floor(since / 60.0)
    last = 2**53 if until is None else math.ceil(until / 60.0) - 1
    yield _Header(format=FORMAT, since=since, until=until, device=device)
    with engine.connect() as connection:
        if device is None:
            yield from (erased := _erased(connection))
        blocks = select(BlockRow).where(BlockRow.minute.between(first, last))
        if device is not None:
            blocks = blocks.where(BlockRow.kind == "device", BlockRow.subject == device)
        for row in _pages(connection, blocks, BlockRow.id):
            yield _Block(*(getattr(row, name) for name in _Block.__struct_fields__))
        alerts = select(AlertRow).where(AlertRow.t >= first * 60.0, AlertRow.t < (last + 1) * 60.0)
        if device is not None:
            alerts = alerts.where(or_(AlertRow.device == device, AlertRow.other_device == device))
        for row in _pages(connection, alerts, AlertRow.id):
            yield _Alert(
                id=row.id,
                device=row.device if device in (None, row.device) else None,
                other_device=row.other_device if device in (None, row.other_device) else None,
                told=row.told,
            )
        if device is None:
            counts = select(OccupancyRow).where(OccupancyRow.minute.between(first, last))
            for counted in connection.execution_options(yield_per=AT_ONCE).execute(counts):
                yield _Occupancy(*(getattr(counted, name) for name in _Occupancy.__struct_fields__))
    if device is None:
        # Again, and from another connection: who withdrew meanwhile may stand in what is written already.
        with engine.connect() as connection:
            yield from (row for row in _erased(connection) if row not in erased)


def _erased(connection: Connection) -> list[_Erased]:
    return [_Erased(device=row[0], t=row[1]) for row in connection.execute(select(ErasedRow.device, ErasedRow.t))]


def _pages(connection: Connection, asked: Select[Any], key: Any) -> Iterator[Any]:
    """Yield rows in the order of their key, some at a time: a whole history does not fit into memory."""
    last: Any = None
    while True:
        page = asked if last is None else asked.where(key > last)
        rows = connection.execute(page.order_by(key).limit(AT_ONCE)).all()
        yield from rows
        if len(rows) < AT_ONCE:
            return
        last = rows[-1].id


def _read(source: Path) -> Iterator[tuple[int, _Erased | _Block | _Alert | _Occupancy]]:
    """Yield line numbers and rows of a file that is whole."""
    rows = 0
    ended = False
    try:
        with gzip.open(source, "rb") as file:
            for number in range(1, 2**62):
                text = file.readline(LONGEST_LINE)
                if not text:
                    break
                if ended or len(text) >= LONGEST_LINE:
                    raise TransferError(f"{source}, line {number}: too long, or after the end")
                line = _line(source, number, text)
                if number == 1:
                    if not isinstance(line, _Header) or line.format != FORMAT:
                        raise TransferError(f"{source}: is no file of `atrium history export`: allowed: {FORMAT}")
                elif isinstance(line, _End):
                    ended = True
                    if line.rows != rows:
                        raise TransferError(f"{source}: holds {rows} rows, should hold {line.rows}")
                elif isinstance(line, _Header):
                    raise TransferError(f"{source}, line {number}: begins anew")
                else:
                    rows += 1
                    yield number, line
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise TransferError(f"{source}: is cut off, damaged or not packed by gzip: {error}") from error
    if not ended:
        raise TransferError(f"{source}: is cut off after {rows} rows")


def _line(source: Path, number: int, text: bytes) -> _Line:
    try:
        return _decoder.decode(text)
    except msgspec.MsgspecError as error:
        raise TransferError(f"{source}, line {number}: {error}") from error


def _checked_block(line: _Block, number: int) -> _Block:
    names = (line.subject, line.area, line.floor)
    if not all(map(is_identifier, names)) or not 0 <= line.minute < LATEST / 60.0 or not 0.0 < line.step <= 3600.0:
        raise TransferError(
            f"line {number}: subject, area, floor {names}, minute {line.minute}, step {line.step}; allowed: "
            "identifiers, minutes since the epoch, seconds up to 3600"
        )
    try:
        values = check(line.points)
    except BlockError as error:
        raise TransferError(f"line {number}: points: {error}") from error
    in_minute = (values[0] >= 0) & (values[0] < 60_000) & (np.diff(values[0], prepend=-1) > 0)
    if not in_minute.all() or not ((values[6] >= 0) & (values[6] < len(STATES))).all():
        raise TransferError(f"line {number}: points: allowed: in the order of time within a minute, known states")
    return line


def _put_blocks(connection: Connection, lines: list[_Block]) -> None:
    erased = erased_among(connection, {line.subject for line in lines if line.kind == "device"})
    kept = [line for line in lines if line.kind == "track" or line.subject not in erased]
    keys: list[Key] = [(line.kind, line.subject, line.minute, line.area, line.floor) for line in kept]
    found = find_blocks(connection, keys)
    blocks = {}
    for key, line in zip(keys, kept, strict=True):
        _, new = decode([line.points])
        blocks[key] = merge(new, found[key]) if key in found else new
    put_blocks(connection, blocks, {key: line.step for key, line in zip(keys, kept, strict=True)})


def _put(connection: Connection, line: _Erased | _Block | _Alert | _Occupancy, number: int) -> None:
    if isinstance(line, _Erased):
        if not is_identifier(line.device) or not plausible(line.t):
            raise TransferError(f"line {number}: device {line.device!r}, t {line.t}; allowed: an identifier, seconds")
        forget(connection, line.device, line.t)
    elif isinstance(line, _Alert):
        try:
            alert = decode_message(line.told.encode(), Alert)
        except MessageError as error:
            raise TransferError(f"line {number}: told: {error}") from error
        if alert.id != line.id or not plausible(alert.t) or alert.device or alert.other_device:
            raise TransferError(f"line {number}: told: is not alert {line.id!r} without devices' names")
        erased = erased_among(connection, {name for name in (line.device, line.other_device) if name})
        row = {
            "id": line.id,
            "t": alert.t,
            "zone": alert.zone,
            "kind": alert.kind,
            "device": None if line.device in erased else line.device,
            "other_device": None if line.other_device in erased else line.other_device,
            "told": line.told,
        }
        connection.execute(upsert(connection, AlertRow, [row], ["id"], []))
    elif isinstance(line, _Occupancy):
        values = (line.counts, line.people, line.most, line.phones)
        whole = all(0 <= value < 2**31 for value in values) and 0 <= line.minute < LATEST / 60.0
        if not whole or line.counts == 0 or not is_identifier(line.place):
            raise TransferError(f"line {number}: place {line.place!r}, {values}; allowed: an identifier, whole numbers")
        keys = ["kind", "place", "minute"]
        connection.execute(upsert(connection, OccupancyRow, [msgspec.structs.asdict(line)], keys, []))
