"""``/v1/privacy/retention``: what each running service keeps of people, and for how long, as it is set now."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence

import msgspec
from fastapi import APIRouter
from starlette.responses import Response

from services.api.erasure_replies import KeptFor, RetentionReport
from services.api.openapi import documented
from shared.kept import rows_of
from shared.keys import Keys

__all__ = ["AskAll", "retention_report", "retention_routes"]

PATIENCE = 2.0
"""Seconds services have to answer."""

AskAll = Callable[[str, float], Iterable[tuple[str, bytes]]]
"""Key and seconds to wait of a query; returns key and payload of every answer."""


def retention_report(now: float, told: Iterable[tuple[str, bytes]], expected: Sequence[str]) -> RetentionReport:
    """Return what services told, processes of one kind that tell the same as one.

    Args:
        now: wall clock.
        told: keys and payloads of their answers; what is not understood is left out.
        expected: services that should have answered.
    """
    rows, heard = rows_of(told)
    kept = [KeptFor(service=service, **msgspec.structs.asdict(row)) for service, row in rows]
    return RetentionReport(t=now, kept=kept, silent=sorted(set(expected) - heard))


def retention_routes(keys: Keys, ask: AskAll, expected: Sequence[str]) -> APIRouter:
    """Return the route; ``expected``: services that should answer."""
    router = APIRouter(prefix="/v1/privacy", tags=["privacy"], default_response_class=Response)

    @router.get("/retention", responses=documented(RetentionReport))
    def retention() -> Response:
        """What each running service keeps of people and for how long, as it is set now; `silent` did not answer."""
        report = retention_report(time.time(), ask(keys.kept(), PATIENCE), expected)
        return Response(msgspec.json.encode(report), media_type="application/json")

    return router
