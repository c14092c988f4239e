"""The HTTP application: every path of the API, thin over ``LiveState`` and ``Hub``."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from typing import Annotated

import msgspec
from fastapi import APIRouter, FastAPI, Query
from fastapi_offline import FastAPIOffline
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware
from starlette.responses import RedirectResponse, Response

from services.api.alerts.office import AlertOffice
from services.api.auth import Guard, KeyRing
from services.api.hot_reads import HotReads
from services.api.learning_link import LearningLink
from services.api.learning_maps import learning_maps
from services.api.learning_orders import learning_orders
from services.api.learning_reads import learning_reads
from services.api.live_state import LiveState
from services.api.openapi import describe, documented
from services.api.problems import tell_problems, unknown
from services.api.replies import (
    Cameras,
    HealthReport,
    Position,
    Positions,
    SiteView,
    Tracks,
    Zones,
)
from services.api.settings import ApiSettings
from services.api.stream import Hub
from services.api.stream_routes import streams
from shared.site import Site

__all__ = ["create_app"]


def create_app(
    settings: ApiSettings,
    site: Site,
    site_json: bytes,
    live: LiveState,
    hub: Hub,
    health: Callable[[float], HealthReport],
    learning: LearningLink,
    alerts: AlertOffice,
    lifespan: Callable[[FastAPI], AbstractAsyncContextManager[None]] | None = None,
) -> FastAPI:
    """Return the application.

    Args:
        settings: keys and CORS origins are read from here.
        site: to check ids that clients name.
        site_json: the ready body of ``GET /v1/site``.
        live: what is true now.
        hub: where stream readers join; it is told of acknowledgements.
        health: makes the health report of one moment.
        learning: asks the learning service.
        alerts: the inbox and the webhooks.
        lifespan: runs around the life of the server.
    """
    sources: dict[str, Callable[[float], bytes]] = {
        "/v1/positions": live.positions_json,
        "/v1/tracks": lambda now: live.tracks_json(None, now),
        "/v1/zones": live.zones_json,
        "/v1/cameras": live.cameras_json,
        "/v1/site": lambda _: site_json,
    }
    layers = [Middleware(Guard, ring=KeyRing(settings.api_keys)), Middleware(HotReads, sources=sources)]
    if settings.cors_origins:
        headers = ["Authorization", "X-API-Key", "Last-Event-ID"]
        cors = Middleware(
            CORSMiddleware, allow_origins=settings.cors_origins, allow_methods=["GET"], allow_headers=headers
        )
        layers.insert(0, cors)
    app = FastAPIOffline(redoc_url=None, title="Atrium", version="1", lifespan=lifespan, middleware=layers)
    tell_problems(app)
    describe(app)
    app.include_router(_reads(site, site_json, live, health))
    for router in (learning_reads(site, learning), learning_maps(site, learning), learning_orders(learning)):
        app.include_router(router)
    for router in (streams(site, live, hub, alerts.past, settings.stream_patience), *alerts.routers(hub)):
        app.include_router(router)

    @app.get("/", include_in_schema=False)
    async def root() -> RedirectResponse:
        return RedirectResponse("/docs")

    return app


def _json(body: bytes) -> Response:
    return Response(body, media_type="application/json")


def _reads(site: Site, site_json: bytes, live: LiveState, health: Callable[[float], HealthReport]) -> APIRouter:
    router = APIRouter(prefix="/v1", default_response_class=Response)
    areas = [area.id for area in site.areas]

    @router.get("/positions", tags=["positions"], responses=documented(Positions))
    async def positions() -> Response:
        """Where every located device is, or was last, while that is not too long ago (see age)."""
        return _json(live.positions_json(time.time()))

    @router.get("/positions/{device}", tags=["positions"], responses=documented(Position, 404))
    async def position(device: str) -> Response:
        """Where one device is."""
        found = live.position(device, time.time())
        if found is None:
            raise unknown("device", device)
        return _json(msgspec.json.encode(found))

    @router.get("/tracks", tags=["positions"], responses=documented(Tracks, 404))
    async def tracks(area: Annotated[str | None, Query(description="only this area")] = None) -> Response:
        """Everybody, also people without a phone, in the newest frame of each area."""
        if area is not None and area not in areas:
            raise unknown("area", area, areas)
        return _json(live.tracks_json(area, time.time()))

    @router.get("/zones", tags=["zones"], responses=documented(Zones))
    async def zone_list() -> Response:
        """The zones and how many people are in each now."""
        return _json(live.zones_json(time.time()))

    @router.get("/site", tags=["site"], responses=documented(SiteView))
    async def site_view() -> Response:
        """What a map needs: floors, areas, cameras and what they see, access points, zones."""
        return _json(site_json)

    @router.get("/cameras", tags=["site"], responses=documented(Cameras))
    async def cameras() -> Response:
        """How each camera is doing."""
        return _json(live.cameras_json(time.time()))

    @router.get("/health", tags=["health"], responses=documented(HealthReport))
    async def health_now() -> Response:
        """Whether everything works, and what does not, in plain words."""
        return _json(msgspec.json.encode(health(time.time())))

    return router
