"""The HTTP application: every path of the API, thin over ``LiveState`` and ``Hub``."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager

import msgspec
from fastapi import APIRouter, Depends, FastAPI
from fastapi_offline import FastAPIOffline
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware
from starlette.responses import RedirectResponse, Response

from services.api.admin.administration import Administration, admin_routes
from services.api.admin.audit_layer import Audited
from services.api.alerts.office import AlertOffice
from services.api.auth import Guard, KeyRing
from services.api.calibration_routes import calibration_routes
from services.api.erasures import ErasureBoard, erasure_routes
from services.api.history_link import HistoryLink
from services.api.history_reads import history_reads
from services.api.hot_reads import HotReads
from services.api.known_queries import only_known_queries
from services.api.learning_link import LearningLink
from services.api.learning_maps import learning_maps
from services.api.learning_orders import learning_orders
from services.api.learning_reads import learning_reads
from services.api.live_state import LiveState
from services.api.nameless import reads_rules
from services.api.openapi import UNCHANGED, describe, documented, named
from services.api.position_routes import position_routes
from services.api.problems import tell_problems
from services.api.replies import (
    Cameras,
    HealthReport,
    SiteView,
)
from services.api.retention import AskAll, retention_routes
from services.api.settings import ApiSettings
from services.api.stream import Hub
from services.api.stream_routes import streams
from services.api.withdrawal_link import withdraw
from shared.keys import Keys
from shared.site import Site

__all__ = ["create_app"]


def create_app(
    settings: ApiSettings,
    site: Site,
    live: LiveState,
    hub: Hub,
    health: Callable[[float], HealthReport],
    learning: LearningLink,
    history: HistoryLink,
    erasures: ErasureBoard,
    admin: Administration,
    alerts: AlertOffice,
    lifespan: Callable[[FastAPI], AbstractAsyncContextManager[None]] | None = None,
    ask: Callable[[str, float, bytes | None], bytes | None] = lambda *_: None,
    ask_all: AskAll = lambda *_: (),
    set_up: Callable[[], None] = lambda: None,
) -> FastAPI:
    """Return the application.

    Args:
        settings: keys and CORS origins are read from here.
        site: to check ids that clients name.
        live: what is true now.
        hub: where stream readers join; it is told of acknowledgements.
        health: makes the health report of one moment.
        learning: asks the learning service.
        history: asks the history service.
        erasures: who withdrew consent and where that was carried out.
        admin: zones, exhibits, keys and people.
        alerts: the inbox and the webhooks.
        lifespan: runs around the life of the server.
        ask: sends a query over the bus: key, seconds to wait, payload; None where nobody answers.
        ask_all: sends a query that many answer: key, seconds to wait.
        set_up: called after the set-up was saved.
    """
    sources: dict[str, Callable[[float], bytes]] = {
        "/v1/positions": live.positions_json,
        "/v1/tracks": lambda now: live.tracks_json(None, now),
        "/v1/zones": live.zones_json,
        "/v1/exhibits": lambda _: admin.exhibits_json,
        "/v1/cameras": live.cameras_json,
        "/v1/site": lambda _: admin.site_json,
    }
    ring = KeyRing(settings.keys, lambda: admin.accounts.holders)
    layers = [
        Middleware(Audited, audit=admin.audit),
        Middleware(Guard, ring=ring, note_use=admin.accounts.note_use),
        Middleware(
            HotReads,
            sources=sources,
            naming=frozenset({"/v1/positions", "/v1/tracks"}),
            only_for={"/v1/zones": reads_rules},
        ),
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
    app = FastAPIOffline(
        redoc_url=None,
        title="Atrium",
        version="1",
        lifespan=lifespan,
        middleware=layers,
        dependencies=[Depends(only_known_queries)],
        redirect_slashes=False,
        generate_unique_id_function=named,
    )
    tell_problems(app)
    describe(app)
    app.include_router(position_routes(site, live))
    app.include_router(_reads(live, health, admin))
    app.include_router(admin_routes(admin))
    for router in (learning_reads(site, learning), learning_maps(site, learning), learning_orders(learning)):
        app.include_router(router)
    app.include_router(calibration_routes(site, settings.site_file, ask, live, set_up))
    app.include_router(history_reads(site, history, admin.viewing_places))
    app.include_router(erasure_routes(erasures, functools.partial(withdraw, Keys(site.site), ask)))
    app.include_router(retention_routes(Keys(site.site), ask_all, [*settings.expected_of(site), "api"]))
    log = streams(site, live, hub, alerts.past, settings.stream_patience, ring)
    for router in (log, *alerts.routers(hub, lambda: live.zones.ids)):
        app.include_router(router)

    @app.get("/", include_in_schema=False)
    async def root() -> RedirectResponse:
        return RedirectResponse("/docs")

    return app


def _json(body: bytes) -> Response:
    return Response(body, media_type="application/json")


def _reads(live: LiveState, health: Callable[[float], HealthReport], admin: Administration) -> APIRouter:
    router = APIRouter(prefix="/v1", default_response_class=Response)

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
