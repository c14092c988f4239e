"""``/v1/alerts``: the inbox, and who has looked at what is in it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Annotated, get_args

import msgspec
import structlog
from fastapi import APIRouter, Depends, Query, Request
from sqlalchemy import Engine
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from services.api.admin.geojson import GEOJSON, Drawing, collection, drawing, placed, point
from services.api.alerts.alert_replies import Acknowledged, Alerts, InboxAlert, Note
from services.api.alerts.inbox import AcknowledgedError, AlertInbox, Wanted
from services.api.auth import needs
from services.api.database_away import database_away
from services.api.examples import EXAMPLES
from services.api.json_answer import json_answer
from services.api.nameless import nameless
from services.api.openapi import documented
from services.api.openapi import drawn as drawn_too
from services.api.problems import Problem, ProblemError, check_order, unknown
from services.api.request_body import described, invalid, read_body, read_object
from services.api.seen import ALL, Seen, saw, saw_rows
from services.api.stream import Hub
from services.api.times import TIME, Time
from shared.keys import is_identifier
from shared.messages import AlertKind
from shared.site import Site
from shared.site.geographic import PlanOnEarth

__all__ = ["alert_routes"]

log = structlog.get_logger(__name__)

LARGEST_NOTE = 16_384
"""Bytes."""


def alert_routes(
    site: Site, zones: Callable[[], Iterable[str]], engine: Engine, inbox: AlertInbox, hub: Hub
) -> APIRouter:
    """Return the routes.

    Args:
        site: to check ids of areas.
        zones: the ids of the zones that hold now; what a zone told that is no more can be asked for all the same.
        engine: the database, for what is said when it is away.
        inbox: the alerts.
        hub: is told who has looked at which.
    """
    router = APIRouter(prefix="/v1/alerts", tags=["alerts"], default_response_class=Response)
    areas = [area.id for area in site.areas]
    earth = PlanOnEarth.of(site)
    example = msgspec.convert(EXAMPLES[InboxAlert], InboxAlert)
    as_geojson = collection([point(example.id, example, None)])

    def told(request: Request, alert: InboxAlert) -> InboxAlert:
        """Which phones it is about only those hear who may read positions."""
        return alert if "positions" in request.state.holder.scopes else nameless(alert)

    @router.get("", responses=drawn_too(documented(Alerts, 404, 422, 503), as_geojson))
    def alerts(
        request: Request,
        drawn: Annotated[Drawing, Depends(drawing)],
        since: Annotated[Time | None, Query(description=f"only alerts measured after this time, {TIME}")] = None,
        until: Annotated[Time | None, Query(description="and no later than this")] = None,
        zone: Annotated[str | None, Query(description="only this zone")] = None,
        area: Annotated[str | None, Query(description="only this area")] = None,
        device: Annotated[str | None, Query(description="only alerts about this device")] = None,
        kinds: Annotated[str | None, Query(description="only these kinds, with commas")] = None,
        acknowledged: Annotated[
            bool | None, Query(description="only those somebody has looked at (true), or nobody (false)")
        ] = None,
        limit: Annotated[int, Query(ge=1, le=1000, description="at most this many")] = 100,
        before: Annotated[str | None, Query(description="the next page: next of the answer before")] = None,
        after: Annotated[
            str | None,
            Query(
                description="only alerts that came after the one of this id, first come first; empty: from the first"
            ),
        ] = None,
    ) -> Response:
        """What zones told, newest first; with after, in the order it came, so that nothing is missed.

        Which phones it was about (`device`, `other_device`) is told to keys with the scope `positions` too.
        """
        check_order(since, until)
        wanted = Wanted(since, until, zone, area, device, _kinds(kinds), acknowledged)
        with database_away(engine):
            if zone is not None and zone not in zones() and not (is_identifier(zone) and inbox.has_zone(zone)):
                raise unknown("zone", zone, list(zones())[:100])
            if area is not None and area not in areas:
                raise unknown("area", area, areas)
            if device is not None:
                needs(request.state.holder, "positions")
                if not is_identifier(device):
                    raise unknown("device", device)
            held = ["the id of an alert that is still held", "nothing"]
            cursor = _known("after" if after is not None else "before", after if after is not None else before, held)
            try:
                if after is not None:
                    found = inbox.arrived(wanted, limit + 1, cursor or "")
                else:
                    found = inbox.newest(wanted, limit + 1, cursor)
            except KeyError:
                raise unknown("after" if after is not None else "before", cursor or "", held) from None
        page = found[:limit]
        following = page[-1].id if len(found) > limit else None
        saw(request, ALL if device is None else Seen((device,)))
        rows = [told(request, one) for one in page]
        now = time.time()
        if drawn.geojson:
            on_earth = placed(drawn.crs, earth)
            body = collection([point(alert.id, alert, on_earth) for alert in rows], t=now, next=following)
            return Response(msgspec.json.encode(body), media_type=GEOJSON)
        return json_answer(Alerts(t=now, alerts=rows, next=following))

    @router.get("/{alert}", responses=documented(InboxAlert, 404, 503))
    def alert(request: Request, alert: str) -> Response:
        """One alert."""
        with database_away(engine):
            found = told(request, _named(alert, inbox.one))
        saw_rows(request, [found.device, found.other_device])
        return json_answer(found)

    @router.post(
        "/{alert}/acknowledge",
        responses=documented(InboxAlert, 404, 409, 413, 422, 503),
        openapi_extra=described(Note, {"note": "a school class, all is well"}),
    )
    async def acknowledge(alert: str, request: Request) -> Response:
        """Say that you have looked at an alert, and what of it; the first one who does counts."""
        body = await read_body(request, LARGEST_NOTE)
        note = read_object(body, Note, '{"note": …}, at most 2000 characters').note if body else ""
        by: str = request.state.holder.name

        def write() -> InboxAlert:
            with database_away(engine):
                return _named(alert, lambda name: inbox.acknowledge(name, by, note, time.time()))

        try:
            seen = await run_in_threadpool(write)
        except AcknowledgedError as error:
            raise ProblemError(
                Problem(
                    type="urn:atrium:acknowledged",
                    title="Acknowledged before",
                    status=409,
                    detail=f"{error.first.by} acknowledged this alert before",
                    field="alert",
                    found=alert[:100],
                    allowed="an alert that nobody has acknowledged",
                )
            ) from error
        log.info("alert acknowledged", alert=seen.id, by=by)
        if seen.acknowledged is not None:
            news = Acknowledged(id=seen.id, acknowledged=seen.acknowledged)
            hub.send("acknowledged", seen.id, news, seen.area, seen.zone)
        return json_answer(told(request, seen))

    return router


def _kinds(text: str | None) -> tuple[str, ...]:
    if text is None:
        return ()
    kinds = tuple(part.strip() for part in text.split(","))
    for kind in kinds:
        if kind not in get_args(AlertKind):
            raise invalid("kinds", repr(kind[:64]), ", ".join(get_args(AlertKind)))
    return kinds


def _known(field: str, alert_id: str | None, allowed: list[str]) -> str | None:
    """Refuse an id that no alert can have, and no database takes as text."""
    if alert_id and not alert_id.isprintable():
        raise unknown(field, alert_id, allowed)
    return alert_id


def _named(alert_id: str, ask: Callable[[str], InboxAlert]) -> InboxAlert:
    try:
        if not alert_id.isprintable():
            raise KeyError(alert_id)
        return ask(alert_id)
    except KeyError:
        raise unknown("alert", alert_id) from None
