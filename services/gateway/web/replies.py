"""How are answers and errors told? Every error in the one form of ``ErrorReply``, whoever raised it."""

from __future__ import annotations

import msgspec
import structlog
from fastapi import FastAPI, Request, Response
from prometheus_client import Counter
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from services.gateway.errors import RequestError
from services.gateway.phones.phone_book import busy
from services.gateway.protocol import FieldError

__all__ = ["encode", "error_of", "refusal", "report_errors", "respond"]

REFUSED = Counter("atrium_gateway_refused_total", "Requests refused", ["status"])

log = structlog.get_logger(__name__)

encode = msgspec.json.Encoder().encode


def respond(value: msgspec.Struct, status: int = 200, headers: dict[str, str] | None = None) -> Response:
    """Return a Struct as the JSON body of a response."""
    return Response(encode(value), status, headers, "application/json")


def refusal(error: RequestError) -> Response:
    """Return the response to a refused request, and count it."""
    REFUSED.labels(str(error.status)).inc()
    return respond(error.reply, error.status, error.headers)


def error_of(error: Exception) -> RequestError:
    """Return any exception in the form that its sender is told."""
    if isinstance(error, RequestError):
        return error
    if isinstance(error, SQLAlchemyError):
        log.warning("database failed", error=str(error).splitlines()[0])
        return busy("the database is away")
    return RequestError(500, FieldError(field="", problem="the gateway failed; it has been logged"))


def report_errors(app: FastAPI) -> None:
    """Give every error of an application the one form."""

    @app.exception_handler(HTTPException)
    async def other(request: Request, error: HTTPException) -> Response:
        problem = FieldError(field="path", problem=str(error.detail), found=f"{request.method} {request.url.path}")
        return refusal(RequestError(error.status_code, problem, headers=dict(error.headers or {})))

    @app.exception_handler(ClientDisconnect)
    async def gone(_request: Request, _error: ClientDisconnect) -> Response:
        return Response(status_code=400)  # nobody is there to read it

    async def told(_request: Request, error: Exception) -> Response:
        return refusal(error_of(error))

    for kind in (RequestError, SQLAlchemyError, Exception):
        app.add_exception_handler(kind, told)
