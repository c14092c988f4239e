"""``/v1/audit``: who changed what, and who looked whom up."""

from __future__ import annotations

import time
from typing import Annotated

from fastapi import APIRouter, Query
from sqlalchemy import Engine
from starlette.responses import Response

from services.api.admin.account_replies import AuditEntry, AuditPage
from services.api.admin.audit_log import AuditLog
from services.api.database_away import database_away
from services.api.json_answer import unkept_answer
from services.api.openapi import documented
from services.api.problems import check_order
from services.api.times import TIME, Time

__all__ = ["audit_route"]

Moment = Annotated[Time | None, Query(description=TIME)]


def audit_route(audit: AuditLog, engine: Engine) -> APIRouter:
    """Return the route."""
    router = APIRouter(prefix="/v1", tags=["accounts"], default_response_class=Response)

    @router.get("/audit", responses=documented(AuditPage, 422, 503))
    def entries(
        before: Annotated[
            int | None, Query(ge=0, le=2**62, description="only entries before the one of this id")
        ] = None,
        since: Moment = None,
        until: Moment = None,
        who: Annotated[str | None, Query(max_length=128, description="only what this one did")] = None,
        action: Annotated[
            str | None, Query(max_length=16, description="GET: look-ups; POST, PUT, DELETE: changes")
        ] = None,
        limit: Annotated[int, Query(ge=1, le=1000, description="at most this many")] = 100,
    ) -> Response:
        """Every change, look-up, picture of a camera and refused attempt, newest first."""
        check_order(since, until)
        for text in (who, action):
            if text is not None and not text.isprintable():
                return unkept_answer(AuditPage(t=time.time(), entries=[], next=None))
        with database_away(engine):
            audit.keep()
            rows = audit.read(before, since, until, who, action, limit)
        found = [AuditEntry(**row) for row in rows]
        return unkept_answer(
            AuditPage(t=time.time(), entries=found, next=found[-1].id if len(found) == limit else None)
        )

    return router
