"""The door: every request needs a session, except to the sign-in page itself; changes come from our own pages only."""

from __future__ import annotations

from urllib.parse import parse_qs

import structlog
from fastapi import FastAPI, Request
from fastapi.responses import JSONResponse, RedirectResponse, Response
from prometheus_client import Counter
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from services.dashboard.guesses import AttemptLimit, KnownBrowsers
from services.dashboard.own_pages import from_here
from services.dashboard.sessions import Sessions, Visitor
from services.dashboard.sign_in_page import sign_in_page
from services.dashboard.staff_desk import Refused, StaffDesk
from shared.client_address import source_of

__all__ = ["Door", "add_sign_in"]

log = structlog.get_logger(__name__)

SIGN_INS = Counter("atrium_dashboard_sign_ins_total", "Attempts to sign in", ["result"])

COOKIE = "atrium_session"
BROWSER_COOKIE = "atrium_browser"
OPEN_PATHS = frozenset({"/login", "/static/dashboard.css", "/static/favicon.svg"})
LARGEST_FORM = 4096
READS = frozenset({"GET", "HEAD", "OPTIONS"})


class Door:
    """ASGI middleware in front of everything, web sockets included; notes whose request it is for who comes after."""

    def __init__(self, app: ASGIApp, sessions: Sessions) -> None:
        self._app = app
        self._sessions = sessions

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let the request pass, send people to the sign-in page and programs away."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        connection = HTTPConnection(scope)
        is_socket = scope["type"] == "websocket"
        elsewhere = (is_socket or scope["method"] not in READS) and not from_here(connection.headers)
        visitor = self._sessions.anybody
        if not self._sessions.open:
            found = self._sessions.find(connection.cookies.get(COOKIE, ""))
            if found is None and scope["path"] not in OPEN_PATHS:
                await _turn_away(connection)(scope, receive, send)
                return
            visitor = found or visitor
        if elsewhere and is_socket:
            await send({"type": "websocket.close", "code": 1008, "reason": "this is for the dashboard's own pages"})
        elif elsewhere:
            refusal = {"status": 403, "detail": "Changes are taken from the dashboard's own pages only."}
            await JSONResponse(refusal, 403)(scope, receive, send)
        else:
            scope.setdefault("state", {})["visitor"] = visitor
            await self._app(scope, _while_here(visitor, receive) if is_socket else receive, send)


def _turn_away(connection: HTTPConnection) -> ASGIApp:
    if connection.scope["type"] == "websocket":
        return _close
    if connection.scope["method"] == "GET" and "text/html" in connection.headers.get("accept", ""):
        return RedirectResponse("/login", 303)
    return JSONResponse({"detail": "sign in at /login first"}, 401)


async def _close(scope: Scope, receive: Receive, send: Send) -> None:
    await send({"type": "websocket.close", "code": 1008, "reason": "sign in first"})


def _while_here(visitor: Visitor, receive: Receive) -> Receive:
    """Return what receives until the session ends; browsers send a sign of life every few seconds."""

    async def received() -> Message:
        message = await receive()
        return message if visitor.here else {"type": "websocket.disconnect", "code": 1008}

    return received


def add_sign_in(
    app: FastAPI, sessions: Sessions, limit: AttemptLimit, browsers: KnownBrowsers, desk: StaffDesk
) -> None:
    """Add the sign-in page and the door in front of ``app``."""

    @app.get("/login")
    async def page(request: Request) -> Response:
        if sessions.open or sessions.find(request.cookies.get(COOKIE, "")) is not None:
            return RedirectResponse("/", 303)
        return sign_in_page(sessions.shared)

    @app.post("/login")
    async def sign_in(request: Request) -> Response:
        if sessions.open:
            return RedirectResponse("/", 303)
        name, password = await _credentials(request)
        address = source_of(request.client.host if request.client else "")
        source = browsers.source(name, request.cookies.get(BROWSER_COOKIE, "")) or address
        wait = limit.wait(name, source)
        if wait > 0.0:
            SIGN_INS.labels("too many").inc()
            seconds = int(wait) + 1
            refused = Refused(f"Too many attempts. Please wait {seconds} seconds.", 429, seconds)
            return sign_in_page(sessions.shared, refused, name)
        # Counted before it is tried: many at once are many tries.
        limit.count(name, source)
        visitor = await _let_in(name, password, source)
        if isinstance(visitor, Refused):
            if visitor.status != 401:
                limit.count(name, source, -1.0)
            SIGN_INS.labels("wrong" if visitor.status == 401 else "refused").inc()
            log.warning("not signed in", address=address, status=visitor.status)
            return sign_in_page(sessions.shared, visitor, name)
        limit.count(name, source, -1.0)
        SIGN_INS.labels("right").inc()
        before = sessions.find(request.cookies.get(COOKIE, ""))
        if before is not None:
            await desk.sign_out(before)
        response = RedirectResponse("/", 303)
        kept = (
            (COOKIE, sessions.begin(visitor), sessions.seconds),
            (BROWSER_COOKIE, browsers.issue(name), browsers.seconds),
        )
        for cookie, value, seconds in kept:
            response.set_cookie(
                cookie,
                value,
                max_age=seconds,
                path="/" if cookie == COOKIE else "/login",
                httponly=True,
                samesite="lax",
                secure=request.url.scheme == "https",
            )
        return response

    async def _let_in(name: str, password: str, source: str) -> Visitor | Refused:
        if name:
            return await desk.sign_in(name, password, source)
        if sessions.right(password):
            return Visitor(sessions.anybody.key)
        return Refused("This is not the password." if sessions.shared else "Please give your name.", 401)

    @app.post("/logout")
    async def sign_out(request: Request) -> Response:
        visitor = sessions.find(request.cookies.get(COOKIE, ""))
        if visitor is not None:
            await desk.sign_out(visitor)
        response = RedirectResponse("/login", 303)
        response.delete_cookie(COOKIE, httponly=True, samesite="lax")
        return response

    @app.get("/session", status_code=204)
    async def session() -> None:
        """Tell a page whether its session still holds (204) or has ended (401, from the door)."""

    app.add_middleware(Door, sessions=sessions)


async def _credentials(request: Request) -> tuple[str, str]:
    """Return name and password of the form, empty where there is none or the body is none of a sign-in form."""
    body = b""
    async for chunk in request.stream():
        body += chunk
        if len(body) > LARGEST_FORM:
            return "", ""
    try:
        fields = parse_qs(body.decode("ascii"), encoding="utf-8", errors="strict", max_num_fields=10)
    except ValueError:
        return "", ""
    return fields.get("name", [""])[0].strip(), fields.get("password", [""])[0]
