"""``/v1/stream``, ``/v1/events`` and ``/v1/ws``: one event log as server-sent events, lines of JSON, or a WebSocket."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Annotated, Any

import msgspec
from fastapi import APIRouter, Depends, Query, Request, WebSocket
from starlette.requests import HTTPConnection
from starlette.responses import Response

from services.api.alerts.past_alerts import PastAlerts
from services.api.auth import Holder, KeyRing, needs, presented_key
from services.api.event_log import NO_LONGER, NOT_YET, Entry, Framing, ndjson_event
from services.api.live_state import LiveState
from services.api.openapi import error
from services.api.place_filter import NEAR, Place, circle
from services.api.problems import Problem, ProblemError, problem_response, unknown
from services.api.request_body import invalid
from services.api.seen import Seen, saw
from services.api.selection import Selection
from services.api.settings import Scope
from services.api.stream import Hub, Reader
from services.api.stream_replies import NDJSON, SSE, Dialect, StreamResponse, converse
from shared.keys import is_identifier
from shared.site import Site

__all__ = ["streams"]

EVENT_SCOPES: dict[str, Scope] = {
    "tracks": "positions",
    "revision": "positions",
    "alert": "alerts",
    "acknowledged": "alerts",
    "camera": "site",
    "occupancy": "site",
    "trouble": "health",
    "recovered": "health",
}
"""Every kind of event and the scope it needs."""
NAMING = frozenset({"tracks", "revision", "alert"})
"""Those that name phones; to whoever may not read positions alerts name none."""
_EXAMPLE = (
    '{"area":"hall","t":1767225600.2,"floor":["ground"],"track":[12],"x":[9.41],"y":[3.2],"vx":[0.9],"vy":[0.1],'
    '"state":["confirmed"],"device":["d-7f3a"],"device_since":[1767225561.4],"probability":[0.97],'
    '"quality":[0.9],"accuracy":[0.12]}'
)
_LINES = {"schema": {"type": "string"}, "example": f'{{"id":1767225600000041,"event":"tracks","data":{_EXAMPLE}}}\n'}
_EVENTS = {"schema": {"type": "string"}, "example": f"event: tracks\nid: 1767225600000041\ndata: {_EXAMPLE}\n\n"}
_TOLD = (
    "Events `tracks` (TrackColumns), `revision` (Revision), `alert` (Alert), `acknowledged` (Acknowledged), `camera` "
    "(CameraReport), `occupancy` (Occupancy), `trouble` and `recovered` (Trouble), until you "
    "leave; last, where it ends here, `ended` (Problem): why."
)


@dataclass(frozen=True, slots=True)
class _Question:
    """What the query of a stream says."""

    kinds: str | None
    area: str | None
    zone: str | None
    near: str | None
    floor: str | None
    device: str | None
    confidence: float
    since: str | None


async def _question(  # not in a thread: streams are opened also while the pool is full
    kinds: Annotated[
        str | None, Query(description="only these kinds of events, with commas; by default all you may")
    ] = None,
    area: Annotated[str | None, Query(description="only what is of this area")] = None,
    zone: Annotated[
        str | None, Query(description="only people in this zone, revised points in it, its alerts and its count")
    ] = None,
    near: Annotated[
        str | None, Query(max_length=100, description=f"only people, revised points and alerts there; {NEAR}")
    ] = None,
    floor: Annotated[str | None, Query(description="only people, revised points and alerts on this floor")] = None,
    device: Annotated[str | None, Query(description="only this device's rows, revisions and alerts")] = None,
    confidence: Annotated[float, Query(ge=0.0, le=1.0, description="only people tracked with this quality")] = 0.0,
    since: Annotated[
        str | None,
        Query(
            alias="from",
            description="id of an event, or oldest: everything after it, in order and without loss (410: gone)",
        ),
    ] = None,
) -> _Question:
    return _Question(kinds, area, zone, near, floor, device, confidence, since)


_Wanted = Annotated[_Question, Depends(_question)]


@dataclass(frozen=True, slots=True)
class _Asked:
    selection: Selection
    after: int | None
    lossless: bool
    past: tuple[Entry, ...] = ()
    """Alerts from before the log begins."""
    lost: bool = False
    """Whether who comes back missed what is gone."""


def streams(site: Site, live: LiveState, hub: Hub, alerts: PastAlerts, patience: float, ring: KeyRing) -> APIRouter:
    """Return the three routes.

    Args:
        site: to check ids of areas.
        live: the state of cameras.
        hub: where readers join.
        alerts: what the log no longer holds.
        patience: seconds after which a client that takes nothing is dropped.
        ring: asked, while a stream is open, whether its key still holds.
    """
    router = APIRouter(prefix="/v1", default_response_class=Response)
    areas = {area.id: area.floor for area in site.areas}
    floors = [floor.id for floor in site.floors]

    async def asked(connection: HTTPConnection, wanted: _Question) -> _Asked:
        area, device = wanted.area, wanted.device
        if area is not None and area not in areas:
            raise unknown("area", area, list(areas))
        if device is not None and not is_identifier(device):
            raise invalid("device", repr(device[:64]), "an id: 1 to 64 letters, digits, '_', '.' and '-'")
        place = Place(wanted.zone, None if wanted.near is None else circle(wanted.near), wanted.floor)
        place.check(live.zones, floors)
        holder: Holder = connection.state.holder
        events = _events(holder, wanted.kinds)
        personal = "positions" in holder.scopes
        if device is not None:
            needs(holder, "positions")
        selection = Selection(events, area, device, place, wanted.confidence, lambda: live.zones, areas, not personal)
        if personal and events & NAMING:
            named = () if device is None else (device,)
            saw(connection, Seen(named, everybody=not named, stream=", ".join(sorted(events))))
        if wanted.since is not None:
            return await resumed(selection, wanted.since)
        last = connection.headers.get("last-event-id", "")
        if not last:
            return _Asked(selection, None, lossless=False)
        number = int(last) if _is_number(last) else hub.log.alert(last) or await alerts.event_of(last)
        refusal = None if number is None else hub.log.refusal(number)
        if number is None or refusal == NOT_YET:
            return _Asked(selection, None, lossless=False, lost=True)
        if refusal is None:
            return _Asked(selection, number, lossless=False)
        first = hub.log.oldest
        past = await alerts.between(number, first) if "alert" in selection.events else []
        return _Asked(selection, first - 1, lossless=False, past=tuple(past or ()), lost=True)

    async def resumed(selection: Selection, since: str) -> _Asked:
        """Return where to go on without loss; of alerts alone also from before the log begins."""
        if since == "oldest":
            return _Asked(selection, hub.log.oldest - 1, lossless=True)
        if not _is_number(since):
            raise invalid("from", repr(since[:64]), "the id of an event, or oldest")
        reason = hub.log.refusal(int(since))
        if reason is None:
            return _Asked(selection, int(since), lossless=True)
        first = hub.log.oldest
        if reason == NO_LONGER and selection.events == {"alert"}:
            past = await alerts.between(int(since), first)
            if past is not None:
                return _Asked(selection, first - 1, lossless=True, past=tuple(past))
        raise _gone(hub, since, reason)

    def opened(connection: HTTPConnection, ask: _Asked, framing: Framing) -> tuple[Reader, list[bytes]]:
        """Return a new reader, and what it is told first: the present, unless it resumes without loss."""
        key = presented_key(connection.scope)
        holder: Holder = connection.state.holder
        reader = hub.join(
            ask.selection, framing, ask.after, ask.lossless, lambda: ring.refusal(key), account=holder.account
        )
        past = [framed for e in ask.past if (framed := ask.selection.framed(e, framing)) is not None]
        if ask.lossless:
            return reader, past
        first = []
        if ask.lost:
            first.append(framing(None, "lost", b'{"oldest":%d,"newest":%d}' % (hub.log.oldest, hub.log.newest)))
        first += past
        if ask.selection.of_cameras:
            reports = [report for report in live.cameras(time.time()) if ask.selection.area in (None, report.area)]
            first += [framing(None, "camera", msgspec.json.encode(report)) for report in reports]
        present = sorted([*hub.log.present("tracks"), *hub.log.present("occupancy")], key=lambda entry: entry.id)
        wanted = [entry for entry in present if ask.after is None or entry.id <= ask.after]
        return reader, first + [framed for e in wanted if (framed := ask.selection.framed(e, framing)) is not None]

    async def answer(request: Request, wanted: _Question, dialect: Dialect) -> Response:
        ask = await asked(request, wanted)
        _room(hub, request.state.holder)
        reader, first = opened(request, ask, dialect.framing)
        return StreamResponse(hub, reader, dialect, first, patience)

    @router.get(
        "/stream",
        tags=["stream"],
        response_class=Response,
        responses=_answers({"text/event-stream": _EVENTS, "application/x-ndjson": _LINES}),
    )
    async def stream(request: Request, wanted: _Wanted) -> Response:
        """Server-sent events: the present state first, then every change; lines of JSON if you accept only those.

        An event "tracks" comes once per frame of an area, at most ten times a second; a slow reader gets the newest.
        A "revision" replaces what was told of some devices' last seconds. Every kind needs a scope of the key: tracks
        and revision positions, alert and acknowledged alerts, camera and occupancy site,
        trouble and recovered health. Send Last-Event-ID to be told
        the alerts and revisions after that event, or from to be told every event after it.
        """
        accepts = request.headers.get("accept", "")
        lines = NDJSON.media_type in accepts and SSE.media_type not in accepts
        return await answer(request, wanted, NDJSON if lines else SSE)

    @router.get("/events", tags=["stream"], response_class=Response, responses=_answers({NDJSON.media_type: _LINES}))
    async def events(request: Request, wanted: _Wanted) -> Response:
        """The same as lines of JSON with id, event and data; an empty line says that there is nothing new."""
        return await answer(request, wanted, NDJSON)

    @router.websocket("/ws")
    async def socket(websocket: WebSocket, wanted: _Wanted) -> None:
        """Send the same as text messages, one event each."""
        try:
            ask = await asked(websocket, wanted)
            _room(hub, websocket.state.holder)
        except ProblemError as refused:
            await websocket.send_denial_response(problem_response(refused.problem, refused.headers))
            return
        await websocket.accept()
        reader, first = opened(websocket, ask, ndjson_event)
        await converse(websocket, hub, reader, first, patience)

    return router


def _answers(content: dict[str, Any]) -> dict[int | str, dict[str, Any]]:
    told: dict[int | str, dict[str, Any]] = {200: {"description": _TOLD, "content": content}}
    return told | {status: error(status) for status in (401, 403, 404, 410, 422, 429, 503)}


def _events(holder: Holder, kinds: str | None) -> frozenset[str]:
    """Return the events a key may be told and wants to.

    Raises:
        ProblemError: a kind that there is not, or that the key may not be told.
    """
    allowed = {event for event, scope in EVENT_SCOPES.items() if scope in holder.scopes}
    wanted = allowed if kinds is None else {part.strip() for part in kinds.split(",")}
    for kind in sorted(wanted):
        if kind not in EVENT_SCOPES:
            raise invalid("kinds", repr(kind[:64]), ", ".join(EVENT_SCOPES))
    if not wanted or not wanted <= allowed:
        needed = sorted({EVENT_SCOPES[kind] for kind in wanted - allowed} or set(EVENT_SCOPES.values()))
        raise ProblemError(
            Problem(
                type="urn:atrium:forbidden",
                title="Scope missing",
                status=403,
                detail="this key may not be told " + (", ".join(sorted(wanted - allowed)) or "any event"),
                field="Authorization",
                found=f"a key with the scopes {', '.join(sorted(holder.scopes)) or 'none'}",
                allowed=f"a key with the scope {' or '.join(needed)}",
            )
        )
    return frozenset(wanted)


def _gone(hub: Hub, since: str, reason: str) -> ProblemError:
    advice = "with kinds=alert it can be resumed" if reason == NO_LONGER else "the API's clock was set back"
    return ProblemError(
        Problem(
            type="urn:atrium:event-gone",
            title="Cannot resume from there",
            status=410,
            detail=f"event {since} is {reason}: begin anew without from; {advice}",
            field="from",
            found=since,
            allowed=f"oldest, or {hub.log.oldest - 1} to {hub.log.newest}",
        )
    )


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) <= 18


def _room(hub: Hub, holder: Holder) -> None:
    """Let one more stream be opened.

    Raises:
        ProblemError: as many are open as one holder may have, or as there may be.
    """
    status = 503 if hub.full else 429 if hub.full_for(holder.account) else None
    if status is not None:
        words = "this server takes" if status == 503 else f"one key or person may have ({hub.most_of_one})"
        raise ProblemError(
            Problem(
                type="urn:atrium:too-many-streams",
                title="Too many streams",
                status=status,
                detail=f"as many streams are open as {words}; try again later",
            ),
            {"Retry-After": "5"},
        )
