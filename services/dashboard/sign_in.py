"""The door: every request needs a session, except to the sign-in page itself."""

from __future__ import annotations

import html
import time
from urllib.parse import parse_qs

import structlog
from fastapi import FastAPI, Request
from fastapi.responses import HTMLResponse, JSONResponse, RedirectResponse, Response
from prometheus_client import Counter
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Receive, Scope, Send

from services.dashboard.sessions import AttemptLimit, Sessions

__all__ = ["Door", "add_sign_in"]

log = structlog.get_logger(__name__)

SIGN_INS = Counter("atrium_dashboard_sign_ins_total", "Attempts to sign in", ["result"])

COOKIE = "atrium_session"
OPEN_PATHS = frozenset({"/login", "/static/dashboard.css", "/static/favicon.svg"})
LARGEST_FORM = 4096


class Door:
    """ASGI middleware in front of everything, web sockets included."""

    def __init__(self, app: ASGIApp, sessions: Sessions) -> None:
        self._app = app
        self._sessions = sessions

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let the request pass, send people to the sign-in page and programs away."""
        if scope["type"] not in ("http", "websocket") or self._sessions.open or scope["path"] in OPEN_PATHS:
            await self._app(scope, receive, send)
            return
        connection = HTTPConnection(scope)
        if self._sessions.valid(connection.cookies.get(COOKIE, "")):
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": "sign in first"})
        elif scope["method"] == "GET" and "text/html" in connection.headers.get("accept", ""):
            await RedirectResponse("/login", 303)(scope, receive, send)
        else:
            await JSONResponse({"detail": "sign in at /login first"}, 401)(scope, receive, send)


def add_sign_in(app: FastAPI, sessions: Sessions, limit: AttemptLimit) -> None:
    """Add the sign-in page and the door in front of ``app``."""

    @app.get("/login")
    async def sign_in_page(request: Request) -> Response:
        if sessions.open or sessions.valid(request.cookies.get(COOKIE, "")):
            return RedirectResponse("/", 303)
        return _page("")

    @app.post("/login")
    async def sign_in(request: Request) -> Response:
        if sessions.open:
            return RedirectResponse("/", 303)
        address = request.client.host if request.client else "unknown"
        password = await _password(request)
        wait = limit.wait(address, time.monotonic())
        if wait > 0.0:
            SIGN_INS.labels("too many").inc()
            seconds = int(wait) + 1
            return _page(f"Too many attempts. Please wait {seconds} seconds.", 429, {"Retry-After": str(seconds)})
        if password is None or not sessions.right(password):
            limit.failed(address, time.monotonic())
            SIGN_INS.labels("wrong").inc()
            log.warning("wrong password", address=address)
            return _page("This is not the password.", 401)
        SIGN_INS.labels("right").inc()
        response = RedirectResponse("/", 303)
        response.set_cookie(
            COOKIE,
            sessions.issue(),
            max_age=sessions.seconds,
            httponly=True,
            samesite="lax",
            secure=request.url.scheme == "https",
        )
        return response

    @app.post("/logout")
    async def sign_out() -> Response:
        response = RedirectResponse("/login", 303)
        response.delete_cookie(COOKIE, httponly=True, samesite="lax")
        return response

    @app.get("/session", status_code=204)
    async def session() -> None:
        """Tell a page whether its session still holds (204) or has ended (401, from the door)."""

    app.add_middleware(Door, sessions=sessions)


async def _password(request: Request) -> str | None:
    """Return the password in the form, None if there is none or the body is none of a sign-in form."""
    body = b""
    async for chunk in request.stream():
        body += chunk
        if len(body) > LARGEST_FORM:
            return None
    try:
        fields = parse_qs(body.decode("ascii"), encoding="utf-8", errors="strict", max_num_fields=10)
    except ValueError:
        return None
    return fields.get("password", [None])[0]


def _page(problem: str, status: int = 200, headers: dict[str, str] | None = None) -> HTMLResponse:
    note = f'<p class="problem" role="alert">{html.escape(problem)}</p>' if problem else ""
    return HTMLResponse(_PAGE.replace("{note}", note), status, {"Cache-Control": "no-store", **(headers or {})})


_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Atrium: sign in</title>
<link rel="icon" href="/static/favicon.svg">
<link rel="stylesheet" href="/static/dashboard.css">
</head>
<body class="sign-in">
<main>
<form method="post" action="/login">
<h1>Atrium</h1>
<label for="password">Password</label>
<input id="password" name="password" type="password" autocomplete="current-password" required autofocus>
{note}
<button type="submit">Sign in</button>
</form>
</main>
</body>
</html>
"""
