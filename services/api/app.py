"""The HTTP application: every path of the API, thin over ``LiveState`` and ``Hub``."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from typing import Annotated, Any

import msgspec
from fastapi import APIRouter, FastAPI, Query, Request
from fastapi_offline import FastAPIOffline
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware
from starlette.responses import RedirectResponse, Response, StreamingResponse

from services.api.admin.administration import Administration, admin_routes
from services.api.admin.audit_layer import Audited
from services.api.auth import Guard, KeyRing
from services.api.hot_reads import HotReads
from services.api.learning_link import LearningLink
from services.api.learning_maps import learning_maps
from services.api.learning_orders import learning_orders
from services.api.learning_reads import learning_reads
from services.api.live_state import LiveState
from services.api.openapi import UNCHANGED, describe, documented, error
from services.api.position_routes import position_routes
from services.api.problems import Problem, ProblemError, tell_problems, unknown
from services.api.replies import (
    Alerts,
    Cameras,
    HealthReport,
    SiteView,
)
from services.api.settings import ApiSettings
from services.api.stream import Hub, alert_event, camera_event, tracks_event
from shared.site import Site

__all__ = ["create_app"]

_STREAM: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "Events `tracks` (TrackColumns), `revision` (Revision), `alert` (Alert) and `camera` "
        "(CameraReport), until you leave.",
        "content": {
            "text/event-stream": {
                "schema": {"type": "string"},
                "example": 'event: tracks\ndata: {"area":"hall","t":1767225600.2,"floor":["ground"],"track":[12],'
                '"x":[9.41],"y":[3.2],"vx":[0.9],"vy":[0.1],"state":["confirmed"],"device":["d-7f3a"],'
                '"probability":[0.97],"accuracy":[0.12]}\n\n',
            }
        },
    },
    **{status: error(status) for status in (401, 403, 404, 503)},
}


def create_app(
    settings: ApiSettings,
    site: Site,
    live: LiveState,
    hub: Hub,
    health: Callable[[float], HealthReport],
    learning: LearningLink,
    admin: Administration,
    lifespan: Callable[[FastAPI], AbstractAsyncContextManager[None]] | None = None,
) -> FastAPI:
    """Return the application.

    Args:
        settings: keys and CORS origins are read from here.
        site: to check ids that clients name.
        live: what is true now.
        hub: where stream readers join.
        health: makes the health report of one moment.
        learning: asks the learning service.
        admin: zones, exhibits, keys and people.
        lifespan: runs around the life of the server.
    """
    sources: dict[str, Callable[[float], bytes]] = {
        "/v1/positions": live.positions_json,
        "/v1/tracks": lambda now: live.tracks_json(None, now),
        "/v1/zones": live.zones_json,
        "/v1/cameras": live.cameras_json,
        "/v1/site": lambda _: admin.site_json,
    }
    layers = [
        Middleware(Guard, ring=KeyRing(settings.api_keys, lambda: admin.accounts.holders)),
        Middleware(HotReads, sources=sources),
        Middleware(Audited, audit=admin.audit),
    ]
    if settings.cors_origins:
        headers = ["Authorization", "X-API-Key", "Last-Event-ID", "Content-Type", "If-Match", "If-None-Match"]
        methods = ["GET", "POST", "PUT", "DELETE"]
        cors = Middleware(
            CORSMiddleware,
            allow_origins=settings.cors_origins,
            allow_methods=methods,
            allow_headers=headers,
            expose_headers=["ETag", "Location", "Retry-After"],
        )
        layers.insert(0, cors)
    app = FastAPIOffline(redoc_url=None, title="Atrium", version="1", lifespan=lifespan, middleware=layers)
    tell_problems(app)
    describe(app)
    app.include_router(position_routes(site, live))
    app.include_router(_reads(live, health, admin))
    app.include_router(_stream(site, live, hub))
    app.include_router(admin_routes(admin))
    for router in (learning_reads(site, learning), learning_maps(site, learning), learning_orders(learning)):
        app.include_router(router)

    @app.get("/", include_in_schema=False)
    async def root() -> RedirectResponse:
        return RedirectResponse("/docs")

    return app


def _json(body: bytes) -> Response:
    return Response(body, media_type="application/json")


def _reads(live: LiveState, health: Callable[[float], HealthReport], admin: Administration) -> APIRouter:
    router = APIRouter(prefix="/v1", default_response_class=Response)

    @router.get("/alerts", tags=["zones"], responses=documented(Alerts, 404, 422))
    async def alerts(
        since: Annotated[
            float | None, Query(allow_inf_nan=False, description="only alerts measured after this time")
        ] = None,
        zone: Annotated[str | None, Query(description="only this zone")] = None,
        limit: Annotated[int, Query(ge=1, le=1000, description="at most this many")] = 100,
        after: Annotated[
            str | None,
            Query(
                description="only alerts that came after the one of this id, first come first; empty: from the first"
            ),
        ] = None,
    ) -> Response:
        """Who entered and left which zone, newest first; with after, in the order they came, so that none is missed."""
        if zone is not None and zone not in live.zones.ids:
            raise unknown("zone", zone, list(live.zones.ids)[:100])
        if after is not None:
            try:
                return _json(msgspec.json.encode(live.alerts_from(time.time(), after, since, zone, limit)))
            except KeyError:
                raise unknown("after", after, ["the id of an alert that is still held", "nothing"]) from None
        return _json(msgspec.json.encode(live.alerts(time.time(), since, zone, limit)))

    @router.get("/site", tags=["site"], responses=documented(SiteView) | UNCHANGED)
    async def site_view() -> Response:
        """What a map needs: floors, areas, cameras and what they see, access points, zones."""
        return _json(admin.site_json)

    @router.get("/cameras", tags=["site"], responses=documented(Cameras) | UNCHANGED)
    async def cameras() -> Response:
        """How each camera is doing."""
        return _json(live.cameras_json(time.time()))

    @router.get("/health", tags=["health"], responses=documented(HealthReport))
    async def health_now() -> Response:
        """Whether everything works, and what does not, in plain words."""
        return _json(msgspec.json.encode(health(time.time())))

    return router


def _stream(site: Site, live: LiveState, hub: Hub) -> APIRouter:
    router = APIRouter(prefix="/v1", default_response_class=Response)
    areas = [area.id for area in site.areas]

    @router.get("/stream", tags=["stream"], responses=_STREAM)
    async def stream(
        request: Request, area: Annotated[str | None, Query(description="only this area")] = None
    ) -> StreamingResponse:
        """Server-sent events: the present state first, then every change.

        An event "tracks" comes once per frame of an area, at most ten times a second; a slow reader gets the newest.
        A "revision" replaces what was told of some devices' last seconds.
        An "alert" needs a key with the scope alerts, a "camera" one with the scope site. Send Last-Event-ID to be told
        the alerts after that one.
        """
        if area is not None and area not in areas:
            raise unknown("area", area, areas)
        if hub.full:
            raise ProblemError(
                Problem(
                    type="urn:atrium:too-many-streams",
                    title="Too many streams",
                    status=503,
                    detail="as many streams are open as this server takes; try again later",
                ),
                {"Retry-After": "5"},
            )
        scopes = request.state.holder.scopes
        allowed = {"tracks": "positions", "revision": "positions", "alert": "alerts", "camera": "site"}
        reader = hub.join(frozenset(event for event, scope in allowed.items() if scope in scopes), area)
        for report in live.cameras(time.time()):
            reader.offer("camera", report.camera, report.area, camera_event(report))
        for alert in live.alerts_after(request.headers.get("last-event-id", "")):
            reader.offer("alert", alert.zone, alert.area, alert_event(alert))
        for frame in live.frames():
            reader.offer("tracks", frame.area, frame.area, tracks_event(frame))

        async def events() -> AsyncIterator[bytes]:
            try:
                async for chunk in reader.events():
                    yield chunk
            finally:
                hub.leave(reader)

        return StreamingResponse(
            events(), media_type="text/event-stream", headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        )

    return router
