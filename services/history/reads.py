"""Out of the database: positions of everybody hour by hour, one device's points, counts of places."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Engine, func, select

from services.history.blocks import COLUMNS, decode
from services.history.persons import Persons
from services.history.tables import BlockRow, OccupancyRow

__all__ = ["DevicePoints", "Minutes", "Part", "device_points", "minutes_of", "parts_of"]

AT_ONCE = 60
"""Minutes that are in memory together."""


@dataclass(frozen=True, slots=True)
class Part:
    """Positions of an hour at most, in parallel arrays of shape (n,).

    Attributes:
        person: numbers; within a call the same is the same person, as far as that is known.
        known: whether each person so far is the carrier of a known phone, by number.
        floor: numbers, of ``floors``.
        t: s; ``x`` and ``y``: m; ``seconds``: that each stands for.
        floors: names.
    """

    person: NDArray[np.int64]
    known: NDArray[np.bool_]
    floor: NDArray[np.int64]
    t: NDArray[np.float64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    seconds: NDArray[np.float64]
    floors: list[str]


@dataclass(frozen=True, slots=True)
class DevicePoints:
    """Points of one device; parallel, unsorted: s, and in the units of ``services.history.blocks.COLUMNS``."""

    t: NDArray[np.float64]
    values: NDArray[np.int32]
    floor: NDArray[np.int64]
    floors: list[str]


@dataclass(frozen=True, slots=True)
class Minutes:
    """Counts of one place in parallel arrays of shape (n,); sums are over ``counts`` countings."""

    t: NDArray[np.float64]
    counts: NDArray[np.int64]
    people: NDArray[np.int64]
    most: NDArray[np.int64]
    phones: NDArray[np.int64]


def parts_of(engine: Engine, kind: str, since: float, until: float, floor: str | None = None) -> Iterator[Part]:
    """Yield where everybody was, in the order of time.

    Args:
        engine: of history's database.
        kind: track: whom cameras saw, those tracks joined that carried the same phone; device: phones, also unseen.
        since: seconds since the epoch, inclusive.
        until: likewise, exclusive.
        floor: only this one.
    """
    people: dict[tuple[str, str], int] = {}
    known: list[bool] = []
    floors: dict[str, int] = {}
    first, last = math.floor(since / 60.0), math.ceil(until / 60.0)
    persons = _persons(engine, first, last) if kind == "track" else None
    for begin in range(first - first % AT_ONCE, last, AT_ONCE):
        asked = (
            select(BlockRow.subject, BlockRow.minute, BlockRow.area, BlockRow.floor, BlockRow.step, BlockRow.points)
            .where(BlockRow.kind == kind)
            .where(BlockRow.minute.between(max(begin, first), min(begin + AT_ONCE, last) - 1))
        )
        if floor is not None:
            asked = asked.where(BlockRow.floor == floor)
        with engine.connect() as connection:
            rows = connection.execute(asked).all()
        if not rows:
            continue
        who = []
        for subject, _, area, *_ in rows:
            device = subject if persons is None else persons.device(area, subject)
            # A track's number is its area's, a device is the same everywhere.
            number = people.setdefault((area, subject) if device is None else ("", device), len(people))
            if number == len(known):
                known.append(device is not None)
            who.append(number)
        counts, values = decode([row[5] for row in rows], ("ms", "x", "y"))
        t = np.repeat(np.array([row[1] for row in rows], float) * 60.0, counts) + values[0] / 1000.0
        kept = np.flatnonzero((t >= since) & (t < until))
        yield Part(
            np.repeat(np.array(who, np.int64), counts)[kept],
            np.array(known, bool),
            np.repeat(np.array([floors.setdefault(row[3], len(floors)) for row in rows], np.int64), counts)[kept],
            t[kept],
            values[1, kept] / 100.0,
            values[2, kept] / 100.0,
            np.repeat(np.array([row[4] for row in rows], float), counts)[kept],
            list(floors),
        )


def _persons(engine: Engine, first: int, last: int) -> Persons:
    """Return who carried whose phone from the minute ``first`` until just before ``last``."""
    during = BlockRow.minute.between(first, last - 1)
    carried = select(BlockRow.subject, BlockRow.area, BlockRow.tracks).where(BlockRow.kind == "device", during)
    lives = (
        select(BlockRow.area, BlockRow.subject, func.min(BlockRow.minute), func.max(BlockRow.minute))
        .where(BlockRow.kind == "track", during)
        .group_by(BlockRow.area, BlockRow.subject)
    )
    with engine.connect() as connection:
        return Persons(connection.execute(carried), connection.execute(lives))


def device_points(engine: Engine, device: str, since: float, until: float) -> DevicePoints:
    """Return all that is kept of a device from ``since`` until just before ``until``."""
    asked = (
        select(BlockRow.minute, BlockRow.floor, BlockRow.points)
        .where(BlockRow.kind == "device", BlockRow.subject == device)
        .where(BlockRow.minute.between(math.floor(since / 60.0), math.ceil(until / 60.0) - 1))
    )
    with engine.connect() as connection:
        rows = connection.execute(asked).all()
    counts, values = decode([row[2] for row in rows])
    floors: dict[str, int] = {}
    floor = np.repeat(np.array([floors.setdefault(row[1], len(floors)) for row in rows], np.int64), counts)
    t = np.repeat(np.array([row[0] for row in rows], float) * 60.0, counts) + values[COLUMNS.index("ms")] / 1000.0
    kept = np.flatnonzero((t >= since) & (t < until))
    return DevicePoints(t[kept], values[:, kept], floor[kept], list(floors))


def minutes_of(engine: Engine, kind: str, since: float, until: float) -> dict[str, Minutes]:
    """Return the counts of all places of a kind (zone, area), by place; minutes that begin within the period."""
    asked = (
        select(
            OccupancyRow.place,
            OccupancyRow.minute,
            OccupancyRow.counts,
            OccupancyRow.people,
            OccupancyRow.most,
            OccupancyRow.phones,
        )
        .where(OccupancyRow.kind == kind)
        .where(OccupancyRow.minute.between(math.ceil(since / 60.0), math.ceil(until / 60.0) - 1))
    )
    by_place: dict[str, list[tuple[int, ...]]] = {}
    with engine.connect() as connection:
        for row in connection.execute(asked):
            by_place.setdefault(row[0], []).append(tuple(row[1:]))
    found = {}
    for place, rows in by_place.items():
        columns = np.array(rows, np.int64).T
        found[place] = Minutes(columns[0] * 60.0, *columns[1:])
    return found
