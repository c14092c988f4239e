"""``/v1/trajectories``, ``/v1/occupancy``, ``/v1/heatmap``, ``/v1/dwell``, ``/v1/flows``: what happened."""

from __future__ import annotations

import datetime
import time
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Literal
from zoneinfo import ZoneInfo

import msgspec
from fastapi import APIRouter, Depends, Query, Request
from starlette.responses import Response

from services.api.history_formats import CSV, GEOJSON, PARQUET, csv_answer, geojson_answer, parquet_answer
from services.api.history_link import HistoryLink
from services.api.history_replies import DwellReport, FlowReport, HeatMapReport, OccupancyReport, TrajectoryReport
from services.api.history_seats import HistorySeats
from services.api.json_answer import json_answer
from services.api.openapi import documented
from services.api.problems import ProblemError, check_order, invalid_value, unknown
from services.api.seen import Seen, saw
from services.api.times import TIME, Time
from shared.history_query import (
    STATES,
    AskDwell,
    AskFlows,
    AskHeatMap,
    AskOccupancy,
    AskTrajectory,
    Dwell,
    Flows,
    HeatMap,
    OccupancySeries,
    Trajectory,
    numbers,
    whole_grains,
)
from shared.keys import is_identifier
from shared.site import Site
from shared.site.geographic import PlanOnEarth
from shared.zones import ZoneDefinition

__all__ = ["history_reads"]

Since = Annotated[Time | None, Query(description=f"from this time on, {TIME}; default: local midnight of today")]
Until = Annotated[Time | None, Query(description="until just before this time; default: now")]
Day = Annotated[
    str | None,
    Query(description="instead of since and until: a day of the site's time zone such as 2026-11-23", max_length=20),
]
Of = Annotated[
    Literal["people", "phones"],
    Query(description="people: whom cameras saw, with a phone or without; phones: devices, also where no camera saw"),
]
At = Annotated[Literal["zones", "exhibits"], Query(description="at the zones, or in front of the exhibits")]
Shortest = Annotated[float, Query(ge=0, le=3600, description="seconds; who stays for less passes by")]
Away = Annotated[float, Query(ge=0, le=3600, description="seconds of absence that do not end a stay")]


def history_reads(site: Site, link: HistoryLink, exhibits: Callable[[], list[ZoneDefinition]] = list) -> APIRouter:
    """Return the routes.

    Args:
        site: whose time zone rules days.
        link: asks history.
        exhibits: returns the places from which exhibits are looked at.
    """
    # Given back as soon as the answer is made, however slowly it is read.
    seat = Depends(HistorySeats().taken, scope="function")
    router = APIRouter(prefix="/v1", tags=["history"], default_response_class=Response, dependencies=[seat])
    zone = ZoneInfo(site.time_zone)
    floors = [floor.id for floor in site.floors]

    @router.get("/trajectories/{device}", responses=_also(TrajectoryReport, ("geojson", "csv", "parquet")))
    def trajectory(
        request: Request,
        device: str,
        since: Since = None,
        until: Until = None,
        day: Day = None,
        step: Annotated[float, Query(ge=0, le=3600, description="seconds between two points at least; 0: all")] = 0.0,
        format: Annotated[Literal["json", "geojson", "csv", "parquet"], Query(description="of the answer")] = "json",  # noqa: A002
    ) -> Response:
        """Where a device was, at most two days of it: as is known now, revisions applied."""
        if not is_identifier(device):
            raise unknown("device", device)
        saw(request, Seen((device,)))
        begin, end = _period(since, until, day, zone)
        found = link.answer(AskTrajectory(device=device, since=begin, until=end, step=step), Trajectory)
        columns = _columns(found)
        if format == "geojson":
            return geojson_answer(columns, device, PlanOnEarth.of(site))
        if format == "csv":
            return csv_answer(columns, f"trajectory-{device}")
        if format == "parquet":
            said = {"device": device, "site": site.site, "time": "s since the epoch, UTC", "length": "m"}
            return parquet_answer(columns, f"trajectory-{device}", said)
        return json_answer(TrajectoryReport(device=device, since=begin, until=end, **columns))

    @router.get("/occupancy", responses=_also(OccupancyReport, ("csv", "parquet")))
    def occupancy(
        zone_id: Annotated[
            list[str] | None, Query(alias="zone", description="these zones; none: all", max_length=200)
        ] = None,
        of: Annotated[Literal["zone", "area"], Query(description="of zones, or of whole areas")] = "zone",
        since: Since = None,
        until: Until = None,
        day: Day = None,
        step: Annotated[
            int, Query(ge=60, le=86400, description="seconds of one value, whole minutes; 86400: local days")
        ] = 3600,
        format: Annotated[Literal["json", "csv", "parquet"], Query(description="of the answer")] = "json",  # noqa: A002
    ) -> Response:
        """How many people were in each zone, in the mean and at most, by steps that begin at local midnight."""
        begin, end = _period(since, until, day, zone)
        found = link.answer(
            AskOccupancy(since=begin, until=end, zones=zone_id or [], of=of, step=step), OccupancySeries
        )
        if format != "json":
            table: dict[str, list[Any]] = {
                "t": found.t * len(found.places),
                of: [place.id for place in found.places for _ in found.t],
                "people": [value for place in found.places for value in place.people],
                "most": [value for place in found.places for value in place.most],
                "phones": [value for place in found.places for value in place.phones],
            }
            said = {"site": site.site, "step": str(step), "time_zone": site.time_zone}
            return csv_answer(table, "occupancy") if format == "csv" else parquet_answer(table, "occupancy", said)
        return json_answer(
            OccupancyReport(
                since=begin, until=end, step=step, time_zone=found.time_zone, t=found.t, places=found.places
            )
        )

    @router.get("/heatmap", responses=documented(HeatMapReport, 404, 422, 503))
    def heat_map(
        floor: Annotated[str | None, Query(description="which; needed where there are several")] = None,
        since: Since = None,
        until: Until = None,
        day: Day = None,
        cell: Annotated[float, Query(ge=0.1, le=20, description="side of a cell, m")] = 0.5,
        of: Of = "people",
    ) -> Response:
        """Where people spent their time on a floor, in whole quarter hours.

        Of each day nothing is told of a cell in which fewer than five people were; without a known phone, five tracks
        count as one person.
        """
        if floor is None and len(floors) == 1:
            floor = floors[0]
        if floor is None or floor not in floors:
            raise unknown("floor", floor or "", floors)
        begin, end = whole_grains(*_period(since, until, day, zone))
        found = link.answer(AskHeatMap(floor=floor, since=begin, until=end, cell=cell, of=of), HeatMap)
        return json_answer(
            HeatMapReport(
                floor=floor,
                since=begin,
                until=end,
                origin=found.origin,
                cell=found.cell,
                seconds=found.seconds,
                people=found.people,
            )
        )

    @router.get("/dwell", responses=_also(DwellReport, ("csv",)))
    def dwell(
        since: Since = None,
        until: Until = None,
        day: Day = None,
        at: At = "zones",
        of: Of = "people",
        shortest: Shortest = 5.0,
        away: Away = 10.0,
        format: Annotated[Literal["json", "csv"], Query(description="of the answer")] = "json",  # noqa: A002
    ) -> Response:
        """How long people stayed in each zone, or in front of each exhibit; of fewer than five nothing, as in a map."""
        begin, end = whole_grains(*_period(since, until, day, zone))
        places = _places(at, exhibits)
        question = AskDwell(since=begin, until=end, places=places or [], of=of, shortest=shortest, away=away)
        found = Dwell(places=[]) if places == [] else link.answer(question, Dwell)
        if format == "csv":
            names = ("id", "people", "visits", "mean", "median", "p90")
            return csv_answer({name: [getattr(row, name) for row in found.places] for name in names}, "dwell")
        return json_answer(DwellReport(since=begin, until=end, places=found.places))

    @router.get("/flows", responses=_also(FlowReport, ("csv",)))
    def flows(
        since: Since = None,
        until: Until = None,
        day: Day = None,
        at: At = "zones",
        of: Of = "people",
        shortest: Shortest = 5.0,
        away: Away = 10.0,
        within: Annotated[float, Query(gt=0, le=86400, description="seconds on the way at most")] = 600.0,
        format: Annotated[Literal["json", "csv"], Query(description="of the answer")] = "json",  # noqa: A002
    ) -> Response:
        """Where people who left one zone, or exhibit, were next; as of ``heatmap``, nothing of fewer than five."""
        begin, end = whole_grains(*_period(since, until, day, zone))
        places = _places(at, exhibits)
        question = AskFlows(
            since=begin, until=end, places=places or [], of=of, shortest=shortest, away=away, within=within
        )
        found = Flows(zones=[], counts=[]) if places == [] else link.answer(question, Flows)
        if format == "csv":
            legs = [(a, b) for a in range(len(found.zones)) for b in range(len(found.zones)) if a != b]
            table: dict[str, list[Any]] = {
                "from": [found.zones[a] for a, _ in legs],
                "to": [found.zones[b] for _, b in legs],
                "count": [found.counts[a][b] for a, b in legs],
            }
            return csv_answer(table, "flows")
        return json_answer(FlowReport(since=begin, until=end, zones=found.zones, counts=found.counts))

    return router


def _places(at: str, exhibits: Callable[[], list[ZoneDefinition]]) -> list[ZoneDefinition] | None:
    """The places of exhibits; None: the zones, which history knows."""
    return exhibits() if at == "exhibits" else None


def _period(since: float | None, until: float | None, day: str | None, zone: ZoneInfo) -> tuple[float, float]:
    """Return what is asked for as two times."""
    check_order(since, until)
    if day is None:
        now = time.time()
        end = now if until is None else until
        if since is not None:
            return since, end
        today = datetime.datetime.fromtimestamp(now, zone).date()
        return datetime.datetime.combine(today, datetime.time(), zone).timestamp(), end
    if since is not None or until is not None:
        raise ProblemError(invalid_value("day", day, "either a day, or since and until"))
    try:
        begin = datetime.date.fromisoformat(day)
        following = begin + datetime.timedelta(days=1)
        times = [datetime.datetime.combine(date, datetime.time(), zone).timestamp() for date in (begin, following)]
    except (ValueError, OverflowError) as error:
        raise ProblemError(invalid_value("day", day, "a date such as 2026-11-23")) from error
    return times[0], times[1]


def _columns(found: Trajectory) -> dict[str, Any]:
    """The columns of a trajectory as lists."""
    floors, states = numbers(found.floor, whole=True).tolist(), numbers(found.state, whole=True).tolist()
    return {
        "t": numbers(found.t).round(3).tolist(),
        "floor": [found.floors[place] for place in floors],
        "x": numbers(found.x).tolist(),
        "y": numbers(found.y).tolist(),
        "accuracy": numbers(found.accuracy).tolist(),
        "probability": numbers(found.probability).tolist(),
        "track": numbers(found.track, whole=True).tolist(),
        "state": [STATES[place] for place in states],
    }


def _also(body: type[msgspec.Struct], formats: Sequence[str]) -> dict[int | str, dict[str, Any]]:
    """``documented``, with the other formats of the answer."""
    answers = documented(body, 404, 422, 503)
    types = {"geojson": GEOJSON, "csv": CSV.partition(";")[0], "parquet": PARQUET}
    for name in formats:
        schema = {"type": "object"} if name == "geojson" else {"type": "string"}
        if name == "parquet":
            schema["format"] = "binary"
        answers[200]["content"][types[name]] = {"schema": schema}
    return answers
