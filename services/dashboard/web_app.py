"""The dashboard's own HTTP: the stream for browsers, the static files, and headers that keep the page to itself."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import structlog
from fastapi import FastAPI, Request
from fastapi.responses import JSONResponse, Response, StreamingResponse
from starlette.datastructures import MutableHeaders
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from services.dashboard.guesses import AttemptLimit, KnownBrowsers
from services.dashboard.relay import Relay
from services.dashboard.sessions import Sessions, asked_by
from services.dashboard.sign_in import add_sign_in
from services.dashboard.staff_desk import StaffDesk

__all__ = ["build_web_app"]

log = structlog.get_logger(__name__)

STATIC = Path(__file__).parent / "static"

# Vue compiles NiceGUI's templates in the page, hence 'unsafe-eval'; nothing may come from, or go to, another host.
CONTENT_SECURITY_POLICY = "; ".join(
    [
        "default-src 'self'",
        "script-src 'self' 'unsafe-inline' 'unsafe-eval'",
        "style-src 'self' 'unsafe-inline'",
        "img-src 'self' data:",
        "font-src 'self' data:",
        "form-action 'self'",
        "frame-ancestors 'none'",
        "base-uri 'self'",
        "object-src 'none'",
    ]
)


class _Headers:
    """ASGI middleware that adds what a browser needs to know of every answer."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers["Content-Security-Policy"] = CONTENT_SECURITY_POLICY
                headers["X-Content-Type-Options"] = "nosniff"
                headers["Referrer-Policy"] = "same-origin"
                if scope["path"].startswith("/static/"):
                    # The files change with the version: ask each time, 304 is cheap.
                    headers["Cache-Control"] = "no-cache"
            await send(message)

        await self._app(scope, receive, send_with_headers)


def build_web_app(
    relay: Relay,
    sessions: Sessions,
    browsers: KnownBrowsers,
    desk: StaffDesk,
    started: Callable[[], None] = lambda: None,
) -> FastAPI:
    """Return the application without its page: ``/live``, ``/static``, ``/login``.

    Relay and desk run while the application is served; ``started`` is called when requests can be answered.
    """

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        tasks = [asyncio.create_task(work) for work in (relay.run(), desk.watch(sessions))]
        for task in tasks:
            task.add_done_callback(_tell_crash)
        started()
        yield
        for task in tasks:
            task.cancel()

    app = FastAPI(title="Atrium dashboard", docs_url=None, redoc_url=None, openapi_url=None, lifespan=lifespan)

    @app.get("/live")
    async def live(request: Request) -> Response:
        """Stream the present and every change of it (server-sent events)."""
        if relay.busy:
            return JSONResponse({"detail": "too many browsers are watching"}, 503, {"Retry-After": "10"})
        return StreamingResponse(
            relay.watch(asked_by(request, sessions.anybody.key)),
            media_type="text/event-stream",
            headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
        )

    app.mount("/static", StaticFiles(directory=STATIC), name="static")
    add_sign_in(app, sessions, AttemptLimit(), browsers, desk)
    app.add_middleware(_Headers)
    return app


def _tell_crash(task: asyncio.Task[None]) -> None:
    """What ends by itself is a fault of this program: say so, loudly."""
    if not task.cancelled() and task.exception() is not None:
        log.error("the relay, or the watch over sign-ins, broke down", exc_info=task.exception())
