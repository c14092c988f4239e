"""Who is inside of which area of a zone, as people and not as tracks: one visit however many cameras' areas see it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from services.geofence.pairs import Crossing
from services.geofence.people import Person

__all__ = ["Visit", "Visits"]


@dataclass(eq=False)
class Visit:
    """One person is inside of one border since ``t``.

    Attributes:
        seats: under which names the person is inside: of several areas that overlap.
        told: keys of the rules that have told of this visit.
    """

    border: int
    t: float
    x: float
    y: float
    track: int
    seats: list[Person]
    told: set[str] = field(default_factory=set)
    open: bool = True

    @property
    def person(self) -> Person:
        """By whom the visit is told: the one who is inside longest."""
        return self.seats[0]


class Visits:
    """All visits that last."""

    def __init__(self) -> None:
        self._at: dict[int, dict[Person, Visit]] = {}
        self._of: dict[Person, set[int]] = {}

    def enter(self, crossing: Crossing, person: Person, twin: Person | None) -> Visit | None:
        """Note that a person is inside; None where the same person is there already."""
        here = self._at.setdefault(crossing.border, {})
        self._of.setdefault(person, set()).add(crossing.border)
        known = here.get(person) or (here.get(twin) if twin is not None else None)
        if known is not None:
            if person not in known.seats:
                known.seats.append(person)
            here[person] = known
            return None
        visit = Visit(crossing.border, crossing.t, crossing.x, crossing.y, crossing.track, [person])
        here[person] = visit
        return visit

    def leave(self, border: int, person: Person) -> Visit | None:
        """Note that a person is inside no more; return the visit if it is over, None if they are still seen inside."""
        visit = self._at.get(border, {}).pop(person, None)
        borders = self._of.get(person, set())
        borders.discard(border)
        if not borders:
            self._of.pop(person, None)
        if visit is None:
            return None
        visit.seats.remove(person)
        if visit.seats:
            return None
        visit.seats.append(person)
        visit.open = False
        return visit

    def at(self, border: int) -> list[Visit]:
        """Return the visits of one border, each once."""
        return list(dict.fromkeys(self._at.get(border, {}).values()))

    def of(self, person: Person) -> list[Visit]:
        """Return where a person is inside."""
        return [self._at[border][person] for border in sorted(self._of.get(person, ()))]

    def all(self) -> list[Visit]:
        """Return all visits, each once."""
        return [visit for border in self._at for visit in self.at(border)]

    def rebordered(self, becomes: Mapping[int, int]) -> None:
        """Follow borders that have new numbers; what has none is no more."""
        visits = self.all()
        self._at.clear()
        self._of.clear()
        for visit in visits:
            border = becomes.get(visit.border)
            visit.open = border is not None
            if border is None:
                continue
            visit.border = border
            self._put(visit)

    def state(self) -> list[dict[str, Any]]:
        """Return what ``restore`` takes, in plain values."""
        return [
            {
                "border": one.border, "t": one.t, "x": one.x, "y": one.y, "track": one.track,
                "seats": [list(seat) for seat in one.seats], "told": sorted(one.told),
            }
            for one in self.all()
        ]  # fmt: skip

    def restore(self, state: Iterable[dict[str, Any]]) -> None:
        """Be as others were when their ``state`` was taken.

        Raises:
            ValueError, TypeError, KeyError: it is no such state.
        """
        self._at.clear()
        self._of.clear()
        for one in state:
            seats = [(str(area), int(who)) for area, who in one["seats"]]
            self._put(Visit(one["border"], one["t"], one["x"], one["y"], one["track"], seats, set(one["told"])))

    def _put(self, visit: Visit) -> None:
        for seat in visit.seats:
            self._at.setdefault(visit.border, {})[seat] = visit
            self._of.setdefault(seat, set()).add(visit.border)
