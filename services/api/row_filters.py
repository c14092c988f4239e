"""Which rows does a client want, and how many at once? The same questions of positions, tracks and devices."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Protocol, TypeVar

import numpy as np
from fastapi import Query

from services.api.place_filter import NEAR, Place, circle
from services.api.zones_drawn import ZonesDrawn

__all__ = ["Page", "Wanted", "select", "wanted"]


class Row(Protocol):
    """What can be filtered: something with a place and an age."""

    @property
    def floor(self) -> str:
        """Its floor."""

    @property
    def x(self) -> float:
        """Metres."""

    @property
    def y(self) -> float:
        """Metres."""

    @property
    def age(self) -> float:
        """Seconds."""


R = TypeVar("R", bound=Row)
Page = tuple[list[R], str | None]
"""Rows, and the cursor that asks for the next ones; None: there are none."""


@dataclass(frozen=True)
class Wanted:
    """What a client asked for; None: anything."""

    age: float | None
    confidence: float | None
    place: Place
    limit: int
    cursor: str | None


async def wanted(
    age: Annotated[float | None, Query(ge=0.0, allow_inf_nan=False, description="seconds old at most")] = None,
    confidence: Annotated[
        float | None,
        Query(ge=0.0, le=1.0, description="at least; of positions and devices probability, of tracks quality"),
    ] = None,
    zone: Annotated[str | None, Query(description="only in this zone")] = None,
    near: Annotated[str | None, Query(max_length=100, description=NEAR)] = None,
    floor: Annotated[str | None, Query(description="only on this floor")] = None,
    limit: Annotated[int, Query(ge=1, le=1000, description="at most this many")] = 1000,
    cursor: Annotated[
        str | None, Query(max_length=200, description="next of the answer before: go on after that one")
    ] = None,
) -> Wanted:
    """Return what the query of a request asks for."""
    # Async, though nothing is waited for: plain dependencies are run in a thread of their own, which costs more.
    return Wanted(age, confidence, Place(zone, None if near is None else circle(near), floor), limit, cursor)


def select(
    rows: Sequence[R],
    asked: Wanted,
    zones: ZonesDrawn,
    floors: Sequence[str],
    key: Callable[[R], str],
    confidence: Callable[[R], float],
) -> Page[R]:
    """Return the rows that match, by key, from the cursor on and at most as many as asked.

    Args:
        rows: all of them.
        asked: what is wanted.
        zones: those that hold now.
        floors: of the site.
        key: orders rows, unique; what the cursor holds.
        confidence: how sure a row is.

    Raises:
        ProblemError: there is no such zone or floor, or ``near`` leaves open on which of several floors.
    """
    asked.place.check(zones, floors)
    found = [
        row
        for row in rows
        if (asked.age is None or row.age <= asked.age)
        and (asked.confidence is None or confidence(row) >= asked.confidence)
    ]
    if not asked.place.anywhere:
        found = [found[index] for index in np.flatnonzero(asked.place.holds(zones, *places(found))).tolist()]
    found.sort(key=key)
    if asked.cursor is not None:
        found = [row for row in found if key(row) > asked.cursor]
    return found[: asked.limit], key(found[asked.limit - 1]) if len(found) > asked.limit else None


def places(rows: Sequence[Row]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return floors, x and y of rows, (n,) each."""
    return (
        np.array([row.floor for row in rows], dtype=object),
        np.array([row.x for row in rows], dtype=float),
        np.array([row.y for row in rows], dtype=float),
    )
