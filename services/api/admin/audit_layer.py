"""Every change and every look-up goes by here, so that no route can forget to write it down.

An ASGI layer around all others. Routes say what their answers tell of people (``services.api.seen``).
"""

from __future__ import annotations

import asyncio
from typing import Any

import structlog
from sqlalchemy.exc import SQLAlchemyError
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from services.api.admin.audit_log import HOUR, MINUTE, AuditLog, Deed
from services.api.auth import Holder
from services.api.problems import Problem, ProblemError, problem_response
from services.api.seen import Seen
from shared.keys import is_identifier

__all__ = ["Audited", "claimed"]

log = structlog.get_logger(__name__)

READS = frozenset({"GET", "HEAD", "OPTIONS"})
ANSWERS = frozenset({"http.response.start", "websocket.accept", "websocket.http.response.start"})
LONGEST_CLAIM = 64


def claimed(name: str) -> str:
    """Return how the log calls somebody who says to be ``name`` and has not shown it."""
    plain = "".join(letter if letter.isprintable() and letter != '"' else "�" for letter in name[:LONGEST_CLAIM])
    return f'somebody who says "{plain}"'


class Audited:
    """ASGI layer that writes down changes, look-ups, pictures of cameras, and attempts that were refused.

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
        refused = False
        opened: list[Deed] = []

        async def noted(message: Message) -> None:
            nonlocal refused
            if message["type"] in ANSWERS:
                problem, headers = await self._note(scope, message, opened)
                if problem is not None:
                    refused = True
                    await problem_response(problem, headers)(scope, receive, send)
            if not refused:
                await send(message)

        try:
            await self._app(scope, receive, noted)
        finally:
            for deed in opened:
                self._audit.ended(deed)

    async def _note(
        self, scope: Scope, message: Message, opened: list[Deed]
    ) -> tuple[Problem | None, dict[str, str] | None]:
        """Write it down; return why what is asked for cannot be told, because it cannot be written."""
        status: int = message.get("status", 101)
        state = scope.get("state", {})
        holder: Holder | None = state.get("holder")
        account = "" if holder is None else holder.account
        who = _who(holder, state)
        read = scope.get("method", "GET") in READS
        seen: Seen | None = state.get("audit_seen")
        if status == 403 and holder is not None:
            try:
                self._audit.look_up(_deed(scope, who, status, ""), account)
            except ProblemError as full:
                log.warning("a refused request is not in the audit log", who=who, reason=full.problem.detail)
        elif not read and (status < 400 or (status == 401 and "audit_who" in state)):
            made = dict(message.get("headers", ())).get(b"location", b"").decode("latin-1") if status == 201 else ""
            await self._record(_deed(scope, who, status, state.get("audit", ""), made))
        elif read and seen is not None and (status < 400 or (status == 404 and seen.devices)):
            if seen.picture:
                return await self._record(_deed(scope, who, status, "")), {"Retry-After": "5"}
            try:
                opened += self._look_up(scope, who, account, status, seen)
            except ProblemError as full:
                return full.problem, dict(full.headers or {})
        return None, None

    def _look_up(self, scope: Scope, who: str, account: str, status: int, seen: Seen) -> list[Deed]:
        """Count it; return what is to be noted again when it ends.

        Raises:
            ProblemError: it cannot be.
        """
        detail = f"opened: {seen.stream}" if seen.stream else ""
        deeds = []
        for device in seen.devices:
            if not is_identifier(device):
                continue  # nobody can be meant
            path = scope["path"]
            subject = path if device in path.split("/") else f"{path}?device={device}"
            deeds.append(_deed(scope, who, status, detail, subject))
        if seen.everybody:
            deeds.append(_deed(scope, who, status, detail))
        for deed in deeds:
            self._audit.look_up(deed, account, MINUTE if seen.devices or seen.stream else HOUR)
        return deeds if seen.stream else []

    async def _record(self, deed: Deed) -> Problem | None:
        try:
            await asyncio.to_thread(self._audit.record, deed)
        except SQLAlchemyError as error:
            log.error("not written into the audit log", deed=deed, reason=str(error).splitlines()[0])
            return Problem(
                type="urn:atrium:database-away",
                title="Database away",
                status=503,
                detail="what is asked for is written down when it is seen, which is not possible now",
            )
        return None


def _who(holder: Holder | None, state: dict[str, Any]) -> str:
    if "audit_who" in state:
        return str(state["audit_who"])
    if holder is None:
        return "somebody"
    return f"{holder.name} ({holder.id})" if holder.id else holder.name


def _deed(scope: Scope, who: str, status: int, detail: str, subject: str = "") -> Deed:
    return Deed(who, scope.get("method", "GET"), subject or scope["path"], status, detail)
