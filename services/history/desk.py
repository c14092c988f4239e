"""Questions about the past, answered from the database: checks what is asked, reads, leaves the sums to analytics."""

from __future__ import annotations

import functools
import itertools
import time
from collections.abc import Callable, Hashable, Sequence
from typing import NoReturn, TypeAlias, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Engine
from sqlalchemy.exc import SQLAlchemyError

from services.history.analytics.heat_map import HeatMapSum, grid_of
from services.history.analytics.local_time import by_step, step_edges
from services.history.analytics.trajectory import one_way
from services.history.analytics.visits import Visits, VisitSum, dwell_of, flows_of, joined, lasting, told
from services.history.blocks import COLUMNS
from services.history.day_sums import DaySums
from services.history.device_alerts import device_alerts
from services.history.reads import device_points, minutes_of, parts_of
from services.history.sampling import plausible
from shared.database import unreachable
from shared.history_query import (
    FEWEST_PEOPLE,
    LONGEST_PERIOD,
    LONGEST_TRAJECTORY,
    AskAlerts,
    AskDwell,
    AskFlows,
    AskHeatMap,
    AskOccupancy,
    AskTrajectory,
    DeviceAlerts,
    Dwell,
    DwellRow,
    Flows,
    HeatMap,
    HistoryAnswer,
    HistoryQuestion,
    OccupancySeries,
    OfPlace,
    Refusal,
    Trajectory,
    column,
    decode_question,
    whole_grains,
)
from shared.site import Site
from shared.zones import ZoneDefinition

__all__ = ["Desk", "zones_of_site"]

MOST_CELLS = 1_000_000
MOST_STEPS = 50_000
"""Steps times places of a series."""
_Grid: TypeAlias = tuple[NDArray[np.float64], NDArray[np.int64]]
T = TypeVar("T")
KIND = {"people": "track", "phones": "device"}


class _RefusedError(Exception):
    def __init__(self, refusal: Refusal) -> None:
        super().__init__(refusal.words)
        self.refusal = refusal


class Desk:
    """Answers; from any thread.

    Args:
        engine: of history's database.
        site: floors and the time zone are read from here.
        zones: returns the zones that are in force.
        clock: returns seconds since the epoch.
    """

    def __init__(
        self,
        engine: Engine,
        site: Site,
        zones: Callable[[], Sequence[ZoneDefinition]],
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._engine = engine
        self._site = site
        self._zones = zones
        self._days = DaySums(clock)

    def answer(self, payload: bytes) -> bytes:
        """Return the answer to a question, both as they travel."""
        return msgspec.msgpack.encode(self._answer(payload))

    def _answer(self, payload: bytes) -> HistoryAnswer:
        try:
            return self._found(decode_question(payload))
        except msgspec.MsgspecError as error:
            return Refusal(words=f"the question is not understood: {error}", field="question")
        except _RefusedError as error:
            return error.refusal
        except SQLAlchemyError as error:
            return Refusal(words=unreachable(self._engine, error))

    def _found(self, question: HistoryQuestion) -> HistoryAnswer:
        longest = LONGEST_TRAJECTORY if isinstance(question, AskTrajectory) else LONGEST_PERIOD
        _check_period(question.since, question.until, longest)
        if isinstance(question, AskHeatMap | AskDwell | AskFlows):
            since, until = whole_grains(question.since, question.until)
            question = msgspec.structs.replace(question, since=since, until=until)
        if isinstance(question, AskTrajectory):
            return self._trajectory(question)
        if isinstance(question, AskOccupancy):
            return self._occupancy(question)
        if isinstance(question, AskHeatMap):
            return self._heat_map(question)
        if isinstance(question, AskAlerts):
            alerts = device_alerts(self._engine, question.device, question.since, question.until)
            return DeviceAlerts(alerts=alerts)
        if isinstance(question, AskDwell):
            return self._dwell(question)
        return self._flows(question)

    def _trajectory(self, asked: AskTrajectory) -> Trajectory:
        points = device_points(self._engine, asked.device, asked.since, asked.until)
        of = dict(zip(COLUMNS, points.values, strict=True))
        way = one_way(points.t, of["probability"].astype(float), asked.step)
        return Trajectory(
            device=asked.device,
            floors=points.floors,
            t=column(points.t[way]),
            x=column(of["x"][way] / 100.0),
            y=column(of["y"][way] / 100.0),
            accuracy=column(of["accuracy"][way] / 100.0),
            probability=column(of["probability"][way] / 1000.0),
            track=column(of["track"][way]),
            state=column(of["state"][way]),
            floor=column(points.floor[way]),
        )

    def _occupancy(self, asked: AskOccupancy) -> OccupancySeries:
        if asked.step % 60:
            _refuse("step", str(asked.step), "whole minutes of seconds: 60 to 86400")
        found = minutes_of(self._engine, asked.of, asked.since, asked.until)
        if asked.of == "zone":
            known = {zone.id for zone in self._zones() if zone.shape == "area"}
        else:
            known = {area.id for area in self._site.areas}
        for name in asked.zones:
            if name not in known and name not in found:
                _refuse("zone" if asked.of == "zone" else "area", name, ", ".join(sorted(known)) or "none")
        names = asked.zones or sorted(known | found.keys())
        edges = step_edges(asked.since, asked.until, asked.step, self._site.time_zone)
        steps = len(edges) - 1
        if steps * len(names) > MOST_STEPS:
            _refuse("step", str(asked.step), f"steps so long that there are {MOST_STEPS} values at most")
        places = []
        for name in dict.fromkeys(names):
            of = found.get(name)
            if of is None:
                places.append(OfPlace(id=name, people=[None] * steps, most=[None] * steps, phones=[None] * steps))
                continue
            people, most = by_step(edges, of.t, of.counts, of.people, of.most)
            phones, _ = by_step(edges, of.t, of.counts, of.phones, of.most)
            places.append(
                OfPlace(
                    id=name,
                    people=[None if np.isnan(value) else round(value, 3) for value in people.tolist()],
                    most=[None if value < 0 else value for value in most.tolist()],
                    phones=[None if np.isnan(value) else round(value, 3) for value in phones.tolist()],
                )
            )
        return OccupancySeries(time_zone=self._site.time_zone, t=edges[:-1].tolist(), places=places)

    def _heat_map(self, asked: AskHeatMap) -> HeatMap:
        known = [floor.id for floor in self._site.floors]
        if asked.floor not in known:
            _refuse("floor", asked.floor, ", ".join(known))
        bounds = self._site.floor(asked.floor).plan().outline.bounds
        origin, rows, columns = grid_of(bounds, asked.cell)
        if rows * columns > MOST_CELLS:
            _refuse("cell", str(asked.cell), f"metres so large that the floor has {MOST_CELLS} cells at most")

        def of_span(since: float, until: float) -> _Grid:
            total, known = HeatMapSum(origin, asked.cell, rows, columns), np.empty(0, bool)
            for part in parts_of(self._engine, KIND[asked.of], since, until, asked.floor):
                total.add(part.person, part.x, part.y, part.seconds)
                known = part.known
            return total.told(known, FEWEST_PEOPLE)

        def bytes_of(sums: _Grid) -> int:
            return sums[0].nbytes + sums[1].nbytes

        of_days = self._by_day(asked, ("heat", asked.floor, asked.cell), bytes_of, of_span)
        seconds, people = (functools.reduce(np.add, column) for column in zip(*of_days, strict=True))
        return HeatMap(
            floor=asked.floor,
            origin=origin,
            cell=asked.cell,
            seconds=[
                [round(value, 1) if who else None for value, who in zip(row, whose, strict=True)]
                for row, whose in zip(seconds.tolist(), people.tolist(), strict=True)
            ],
            people=[[value or None for value in row] for row in people.tolist()],
        )

    def _dwell(self, asked: AskDwell) -> Dwell:
        places, of_days = self._visits(asked)
        visits = joined([told(day, len(places), FEWEST_PEOPLE) for day in of_days])
        rows = []
        for number, place in enumerate(places):
            stays = dwell_of(visits, number)
            if not stays.people:
                rows.append(DwellRow(id=place.id, people=None, visits=None, mean=None, median=None, p90=None))
                continue
            rows.append(
                DwellRow(
                    id=place.id,
                    people=stays.people,
                    visits=stays.visits,
                    mean=round(stays.mean, 1),
                    median=round(stays.median, 1),
                    p90=round(stays.p90, 1),
                )
            )
        return Dwell(places=rows)

    def _flows(self, asked: AskFlows) -> Flows:
        places, of_days = self._visits(asked)
        sums = np.zeros((len(places), len(places)), np.int64)
        hidden = np.zeros(sums.shape, bool)
        for day in of_days:
            counts, people = flows_of(day, len(places), asked.within)
            few = people < FEWEST_PEOPLE
            sums += np.where(few, 0, counts)
            hidden |= few & (counts > 0)
        return Flows(
            zones=[place.id for place in places],
            counts=[
                [None if hide and not count else count for count, hide in zip(row, hides, strict=True)]
                for row, hides in zip(sums.tolist(), hidden.tolist(), strict=True)
            ],
        )

    def _visits(self, asked: AskDwell | AskFlows) -> tuple[list[ZoneDefinition], list[Visits]]:
        """Return the places and the stays at them, day by day."""
        places = [place for place in asked.places or self._zones() if place.shape == "area"]
        for place in places:
            if len(place.points) < 3:
                _refuse("places", f"{place.id} with {len(place.points)} corners", "three corners or more")

        def of_span(since: float, until: float) -> Visits:
            total, known = VisitSum([np.array(place.points, float) for place in places], asked.away), np.empty(0, bool)
            for part in parts_of(self._engine, KIND[asked.of], since, until):
                known = part.known
                for number, floor in enumerate(part.floors):
                    on = np.flatnonzero(part.floor == number)
                    numbers = [place for place, zone in enumerate(places) if zone.floor == floor]
                    if on.size and numbers:
                        total.add(numbers, part.person[on], part.t[on], part.x[on], part.y[on], part.seconds[on])
            return total.visits(known)

        def bytes_of(visits: Visits) -> int:
            return 5 * visits.begin.nbytes

        corners = tuple((place.floor, tuple(place.points)) for place in places)
        of_days = self._by_day(asked, ("visits", asked.away, corners), bytes_of, of_span)
        return places, [lasting(day, asked.shortest) for day in of_days]

    def _by_day(
        self,
        asked: AskHeatMap | AskDwell | AskFlows,
        what: tuple[Hashable, ...],
        size: Callable[[T], int],
        make: Callable[[float, float], T],
    ) -> list[T]:
        """Return sums of the local days of a period: tracks are somebody else every day, phones are not."""
        if asked.of == "phones":
            return [make(asked.since, asked.until)]
        found = []
        edges = step_edges(asked.since, asked.until, 86400, self._site.time_zone).tolist()
        for midnight, following in itertools.pairwise(edges):
            since, until = max(midnight, asked.since), min(following, asked.until)
            found.append(self._days.get((since, until, *what), until, size, functools.partial(make, since, until)))
        return found


def zones_of_site(site: Site) -> list[ZoneDefinition]:
    """Return the zones a site begins with."""
    return [ZoneDefinition(id=zone.id, name=zone.name, floor=zone.floor, points=zone.polygon) for zone in site.zones]


def _check_period(since: float, until: float, longest: float) -> None:
    for name, t in (("since", since), ("until", until)):
        if not plausible(t):
            _refuse(name, str(t), "seconds since the epoch (UTC)")
    if until <= since:
        _refuse("until", str(until), "later than since")
    if until - since > longest:
        _refuse("until", str(until), f"{longest / 86400.0:.0f} days after since at most")


def _refuse(field: str, found: str, allowed: str) -> NoReturn:
    raise _RefusedError(
        Refusal(words=f"{field}: found {found}; allowed: {allowed}", field=field, found=found, allowed=allowed)
    )
