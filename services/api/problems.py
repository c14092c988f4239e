"""How every error looks: RFC 9457 problem details that name the field, what was found and what is allowed."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
from fastapi import FastAPI, Request, WebSocket
from fastapi.exceptions import RequestValidationError, WebSocketRequestValidationError
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.routing import Match

from services.api.times import TIME

__all__ = ["MEDIA_TYPE", "Problem", "ProblemError", "check_order", "invalid_value", "problem_response", "tell_problems"]

MEDIA_TYPE = "application/problem+json"

_ALLOWED = {
    "age": "seconds, a finite number from 0 on",
    "confidence": "a number from 0 to 1",
    "limit": "a whole number from 1 to 1000",
    "before": "seconds since the epoch (UTC), a finite number such as 1767225600.0",
    "until": TIME,
    "kind": "radio, detector, stride, heading or alignment",
    "acknowledged": "true or false",
    "letter": "the id of a dead letter, a whole number",
    "since": TIME,
}


class Problem(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=False):
    """One error (RFC 9457). ``field``, ``found`` and ``allowed`` are null where no single input is to blame."""

    type: str
    title: str
    status: int
    detail: str
    field: str | None = None
    found: str | None = None
    allowed: str | None = None


class ProblemError(Exception):
    """Raise to answer with a problem."""

    def __init__(self, problem: Problem, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(problem.detail)
        self.problem = problem
        self.headers = headers


def unknown(what: str, found: str, allowed: list[str] | None = None) -> ProblemError:
    """Return the 404 for an id that names nothing; ``allowed`` lists the ids there are, where that is no secret."""
    listed = None if allowed is None else ", ".join(allowed) or "none: the site file names no " + what
    return ProblemError(
        Problem(
            type=f"urn:atrium:unknown-{what.replace(' ', '-').replace('_', '-')}",
            title=f"Unknown {what}",
            status=404,
            detail=f"there is no {what} {_shorten(found)!r}"
            + ("" if listed is None else f"; allowed: {listed}" if allowed else f" ({listed})"),
            field=what,
            found=_shorten(found),
            allowed=listed,
        )
    )


def invalid_value(field: str, found: str, allowed: str, detail: str = "") -> Problem:
    """Return the 422 for one value, said in ``detail`` or in the usual words."""
    return Problem(
        type="urn:atrium:invalid-value",
        title="Invalid value",
        status=422,
        detail=detail or f"{field}: found {found!r}, allowed: {allowed}",
        field=field,
        found=found,
        allowed=allowed,
    )


def check_order(since: float | None, until: float | None) -> None:
    """Refuse a period that ends before it begins.

    Raises:
        ProblemError: it does.
    """
    if since is not None and until is not None and until < since:
        raise ProblemError(invalid_value("until", f"{until:g}", f"a time after since, which is {since:g}"))


def problem_response(problem: Problem, headers: Mapping[str, str] | None = None) -> Response:
    """Return the HTTP response that carries ``problem``."""
    return Response(
        msgspec.json.encode(problem),
        status_code=problem.status,
        media_type=MEDIA_TYPE,
        headers=None if headers is None else dict(headers),
    )


def tell_problems(app: FastAPI) -> None:
    """Make ``app`` answer every error in this one shape."""

    @app.exception_handler(ProblemError)
    async def raised(connection: Request | WebSocket, error: ProblemError) -> Response | None:
        response = problem_response(error.problem, error.headers)
        if isinstance(connection, WebSocket):
            await connection.send_denial_response(response)
            return None
        return response

    @app.exception_handler(RequestValidationError)
    async def invalid(_: Request, error: RequestValidationError) -> Response:
        return problem_response(_first_of(error))

    @app.exception_handler(WebSocketRequestValidationError)
    async def not_opened(websocket: WebSocket, error: WebSocketRequestValidationError) -> None:
        await websocket.send_denial_response(problem_response(_first_of(error)))

    @app.exception_handler(HTTPException)
    async def refused(request: Request, error: HTTPException) -> Response:
        wrong_method = error.status_code == 405
        headers = dict(error.headers or {})
        if wrong_method:
            headers["Allow"] = _methods(request)
        title = "Method not allowed" if wrong_method else "Not found" if error.status_code == 404 else "Refused"
        return problem_response(
            Problem(
                type="urn:atrium:" + title.lower().replace(" ", "-"),
                title=title,
                status=error.status_code,
                detail=f"{request.method} {_shorten(request.url.path)}: {error.detail}",
                field="method" if wrong_method else "path",
                found=request.method if wrong_method else _shorten(request.url.path),
                allowed=headers["Allow"] if wrong_method else "the paths listed at /docs",
            ),
            headers,
        )

    @app.exception_handler(Exception)
    async def failed(_: Request, __: Exception) -> Response:
        return problem_response(
            Problem(
                type="urn:atrium:internal",
                title="Internal error",
                status=500,
                detail="the request failed for a reason of ours; it stands in the log of the api service",
            )
        )


def _methods(request: Request) -> str:
    """Return the methods of all routes of a path: the framework tells those of the first."""
    routes = request.app.routes
    taken = (
        method
        for method in ("DELETE", "GET", "POST", "PUT")
        if any(route.matches({**request.scope, "method": method})[0] is Match.FULL for route in routes)
    )
    return ", ".join(taken)


def _first_of(error: RequestValidationError | WebSocketRequestValidationError) -> Problem:
    first = error.errors()[0]
    field = str(first["loc"][-1]) if first["loc"] else "request"
    words = str(first["msg"])
    if not first["type"].startswith("int_") and first["type"] != "greater_than_equal":  # the id of an entry, not a time
        words = _ALLOWED.get(field, words)
    return invalid_value(field, _shorten(str(first.get("input"))), words)


def _shorten(text: str) -> str:
    return text if len(text) <= 100 else text[:97] + "..."
