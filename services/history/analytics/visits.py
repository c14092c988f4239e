"""When was who at which place? Stays from positions, told part by part; what is told of stays: dwell and flows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from services.history.analytics.anonymity import surely

__all__ = ["DwellStatistics", "VisitSum", "Visits", "dwell_of", "flows_of", "joined", "lasting", "told"]


@dataclass(frozen=True, slots=True)
class Visits:
    """Stays in parallel arrays of shape (n,), by place, person and time: numbers of place and person, s, s.

    ``known``: whether the person is the carrier of a known phone.
    """

    place: NDArray[np.int64]
    person: NDArray[np.int64]
    begin: NDArray[np.float64]
    end: NDArray[np.float64]
    known: NDArray[np.bool_]

    def where(self, kept: NDArray[np.bool_]) -> Visits:
        """Return some of the stays."""
        return Visits(self.place[kept], self.person[kept], self.begin[kept], self.end[kept], self.known[kept])


@dataclass(frozen=True, slots=True)
class DwellStatistics:
    """Of one place: people, visits; mean, median and 90th percentile of their seconds, NaN without any."""

    people: int
    visits: int
    mean: float
    median: float
    p90: float


def lasting(visits: Visits, shortest: float) -> Visits:
    """Return the stays that lasted ``shortest`` seconds or longer."""
    return visits.where(visits.end - visits.begin >= shortest)


def told(visits: Visits, places: int, fewest: int) -> Visits:
    """Return the stays at those of so many places at which surely ``fewest`` people or more were."""
    people = np.unique(np.column_stack([visits.place, visits.person, visits.known]), axis=0)
    count = np.bincount(people[:, 0], minlength=places)
    known = np.bincount(people[people[:, 2] > 0, 0], minlength=places)
    return visits.where((surely(count, known) >= fewest)[visits.place])


def joined(parts: Sequence[Visits]) -> Visits:
    """Return the stays of several days; everybody is new each day."""
    first = np.cumsum([0, *(part.person.max(initial=-1) + 1 for part in parts)])
    place = np.concatenate([np.empty(0, np.int64), *(part.place for part in parts)])
    person = np.concatenate([np.empty(0, np.int64), *(p.person + n for p, n in zip(parts, first, strict=False))])
    begin = np.concatenate([np.empty(0), *(part.begin for part in parts)])
    end = np.concatenate([np.empty(0), *(part.end for part in parts)])
    return Visits(place, person, begin, end, np.concatenate([np.empty(0, bool), *(part.known for part in parts)]))


class VisitSum:
    """Finds stays in positions that come part by part, in the order of time.

    Args:
        polygons: the corners of each place, shape (m, 2) each, m.
        away: seconds of absence that do not end a stay.
    """

    def __init__(self, polygons: Sequence[NDArray[np.float64]], away: float) -> None:
        self._polygons = [shapely.make_valid(shapely.Polygon(corners)) for corners in polygons]
        shapely.prepare(self._polygons)
        self._away = away
        self._runs: list[NDArray[np.float64]] = []

    def add(
        self,
        places: Sequence[int],
        person: NDArray[np.int64],
        t: NDArray[np.float64],
        x: NDArray[np.float64],
        y: NDArray[np.float64],
        seconds: NDArray[np.float64],
    ) -> None:
        """Add points of one floor, shape (n,) each, and the numbers of the places that are on it."""
        order = np.lexsort((t, person))
        person, t, x, y, seconds = person[order], t[order], x[order], y[order], seconds[order]
        for place in places:
            inside = np.flatnonzero(shapely.contains_xy(self._polygons[place], x, y))
            if inside.size:
                runs = _runs(person[inside], t[inside], t[inside] + seconds[inside], self._away)
                self._runs.append(np.column_stack([np.full(len(runs), place), runs]))

    def visits(self, known: NDArray[np.bool_]) -> Visits:
        """Return all stays; ``known``: whether each person is the carrier of a known phone, by number."""
        rows = np.concatenate(self._runs) if self._runs else np.empty((0, 4))
        rows = rows[np.lexsort((rows[:, 2], rows[:, 1], rows[:, 0]))]
        parts = []
        for place in np.unique(rows[:, 0]):
            of = rows[rows[:, 0] == place]
            runs = _runs(of[:, 1].astype(np.int64), of[:, 2], of[:, 3], self._away)
            parts.append(np.column_stack([np.full(len(runs), place), runs]))
        found = np.concatenate(parts) if parts else rows
        person = found[:, 1].astype(np.int64)
        return Visits(found[:, 0].astype(np.int64), person, found[:, 2], found[:, 3], known[person])


def dwell_of(visits: Visits, place: int) -> DwellStatistics:
    """Return how long people stayed at one place."""
    at = visits.place == place
    lasted = visits.end[at] - visits.begin[at]
    people = np.unique(visits.person[at]).size
    if not lasted.size:
        return DwellStatistics(0, 0, np.nan, np.nan, np.nan)
    median, p90 = np.quantile(lasted, [0.5, 0.9])
    return DwellStatistics(people, lasted.size, float(lasted.mean()), float(median), float(p90))


def flows_of(visits: Visits, places: int, within: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return how often somebody who left one place was next at another, and how many people surely did.

    Args:
        visits: stays.
        places: how many there are.
        within: seconds on the way at most.

    Returns:
        Two arrays of shape (places, places), from the row to the column.
    """
    order = np.lexsort((visits.begin, visits.person))
    place, person = visits.place[order], visits.person[order]
    begin, end = visits.begin[order], visits.end[order]
    went = (person[1:] == person[:-1]) & (place[1:] != place[:-1]) & (begin[1:] - end[:-1] <= within)
    leg = place[:-1][went] * places + place[1:][went]
    counts = np.bincount(leg, minlength=places * places)
    once = np.unique(np.column_stack([leg, person[1:][went], visits.known[order][1:][went]]), axis=0)
    people = np.bincount(once[:, 0], minlength=places * places)
    known = np.bincount(once[once[:, 2] > 0, 0], minlength=places * places)
    return counts.reshape(places, places), surely(people, known).reshape(places, places)


def _runs(
    person: NDArray[np.int64], begin: NDArray[np.float64], end: NDArray[np.float64], away: float
) -> NDArray[np.float64]:
    """Join what follows each other within ``away`` seconds: rows of person, begin, end; sorted by person and begin."""
    new = np.ones(person.size, bool)
    new[1:] = (person[1:] != person[:-1]) | (begin[1:] - end[:-1] > away)
    starts = np.flatnonzero(new)
    return np.column_stack([person[starts], begin[starts], np.maximum.reduceat(end, starts)])
