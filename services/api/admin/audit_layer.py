"""Every change and every look-up goes by here, so that no route can forget to write it down.

An ASGI layer behind the keys and the hot reads: what tells of nobody in particular costs nothing.
"""

from __future__ import annotations

import asyncio
from urllib.parse import parse_qs

import structlog
from sqlalchemy.exc import SQLAlchemyError
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from services.api.admin.audit_log import AuditLog, Deed
from services.api.problems import Problem, ProblemError, problem_response

__all__ = ["LOOK_UPS", "QUERY", "Audited"]

log = structlog.get_logger(__name__)

READS = frozenset({"GET", "HEAD", "OPTIONS"})
LOOK_UPS = ("/v1/positions/", "/v1/trajectories/")
"""Below these somebody asks for one person's phone."""
QUERY = "?device="
"""And where it stands in a query: of a stream, or of the past."""
ANSWERS = frozenset({"http.response.start", "websocket.accept"})
EXPORTS = frozenset({"/v1/learning/export"})


class Audited:
    """ASGI layer that writes down changes, look-ups, and pictures of cameras that were answered, and failed sign-ins.

    A route may leave words in ``request.state.audit`` (what there was before), and ``request.state.audit_who``.
    """

    def __init__(self, app: ASGIApp, audit: AuditLog) -> None:
        self._app = app
        self._audit = audit

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hand the request on, and write it down before its answer goes out."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        path = scope["path"]
        read = scope.get("method", "GET") in READS
        picture = read and path.startswith("/v1/cameras/") and path.endswith("/still")
        device = _device(scope["query_string"])
        if read and not (picture or device or path in EXPORTS or path.startswith(LOOK_UPS)):
            await self._app(scope, receive, send)
            return
        refused = False

        async def noted(message: Message) -> None:
            nonlocal refused
            if message["type"] in ANSWERS:
                problem = await self._note(scope, message, device, soon=read and not picture)
                if problem is not None and read and scope["type"] == "http":
                    refused = True
                    await problem_response(problem, {"Retry-After": "5"})(scope, receive, send)
            if not refused:
                await send(message)

        await self._app(scope, receive, noted)

    async def _note(self, scope: Scope, message: Message, device: str, *, soon: bool) -> Problem | None:
        """Write it down; return why it could not be."""
        status: int = message.get("status", 101)
        if status >= 400 and not (scope["path"] == "/v1/session" and status == 401):
            return None
        state = scope.get("state", {})
        holder = state.get("holder")
        who = state.get("audit_who") or (f"{holder.name} ({holder.id})" if holder and holder.id else "")
        made = dict(message.get("headers", ())).get(b"location", b"").decode("latin-1")
        asked = scope["path"] + (f"{QUERY}{device}" if device else "")
        deed = Deed(
            who or (holder.name if holder else "somebody"),
            scope.get("method", "GET"),
            made or asked,
            status,
            state.get("audit", ""),
        )
        try:
            if soon:
                self._audit.look_up(deed)
            else:
                await asyncio.to_thread(self._audit.record, deed)
        except ProblemError as full:
            return full.problem
        except SQLAlchemyError as error:
            log.error("not written into the audit log", deed=deed, reason=str(error).splitlines()[0])
            return Problem(
                type="urn:atrium:database-away",
                title="Database away",
                status=503,
                detail="what is asked for is written down when it is seen, which is not possible now",
            )
        return None


def _device(query: bytes) -> str:
    """Return which device a query names, empty if none."""
    if b"device=" not in query:
        return ""
    return parse_qs(query.decode("latin-1")).get("device", [""])[0]
