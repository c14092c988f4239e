"""What the pages ask of the API, passed on for whoever asks: a short list of reads and writes, nothing else.

The browser speaks to ``/ask/v1/…`` of this process, behind the door; the token of whoever signed in, or the dashboard's
own key, stays here.
"""

from __future__ import annotations

import re
from urllib.parse import quote

import httpx
import structlog
from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse, Response
from prometheus_client import Counter

from services.dashboard.sessions import Visitor, asked_by

__all__ = ["LARGEST_BODY", "pass_through"]

log = structlog.get_logger(__name__)

ASKED = Counter("atrium_dashboard_asked_total", "Requests of pages passed on to the API", ["status"])

LARGEST_BODY = 256 * 1024
"""Bytes; a zone of a thousand corners and fifty rules fits."""
ONE = r"[A-Za-z0-9][A-Za-z0-9_.:-]{0,127}"
READS = re.compile(
    rf"v1/(site|health|cameras|zones|exhibits|tracks|positions(/{ONE})?|alerts|occupancy|heatmap|dwell|flows"
    r"|erasures|privacy/retention|session)"
)
WRITES = {
    "POST": re.compile(rf"v1/(zones|alerts/{ONE}/acknowledge)"),
    "PUT": re.compile(rf"v1/zones/{ONE}"),
    "DELETE": re.compile(rf"v1/(zones|devices)/{ONE}"),
}
KEPT_HEADERS = ("etag", "location", "retry-after")


def pass_through(api_url: str, api_key: str) -> APIRouter:
    """Return the routes below ``/ask``.

    Args:
        api_url: without a slash at the end.
        api_key: the dashboard's own, never shown; sent for whoever did not sign in by name.
    """
    router = APIRouter(include_in_schema=False)
    # The address comes from the operator: proxies of the environment are not for it.
    client = httpx.AsyncClient(timeout=30.0, trust_env=False)

    @router.api_route("/ask/{path:path}", methods=["GET", "POST", "PUT", "DELETE"])
    async def ask(path: str, request: Request) -> Response:
        allowed = READS if request.method == "GET" else WRITES[request.method]
        if allowed.fullmatch(path) is None:
            return _problem(404, "The dashboard passes no such request on to the API.")
        body = b""
        async for chunk in request.stream():
            body += chunk
            if len(body) > LARGEST_BODY:
                return _problem(413, f"This is more than the {LARGEST_BODY // 1024} KiB that the dashboard passes on.")
        visitor = asked_by(request, api_key)
        headers = {name: request.headers[name] for name in ("if-match",) if name in request.headers}
        headers["Authorization"] = f"Bearer {visitor.key}"
        if body:
            headers["Content-Type"] = "application/json"
        try:
            answer = await client.request(
                request.method,
                f"{api_url}/{quote(path, safe='/:')}",
                params=httpx.QueryParams(request.url.query),
                content=body or None,
                headers=headers,
            )
        except httpx.HTTPError as error:
            log.debug("no answer", error=repr(error))
            ASKED.labels("none").inc()
            return _problem(502, "The API does not answer; is it running?")
        ASKED.labels(str(answer.status_code)).inc()
        if answer.status_code in (401, 403):
            return _refused(visitor, answer.status_code)
        kept = {name: answer.headers[name] for name in KEPT_HEADERS if name in answer.headers}
        return Response(
            answer.content,
            answer.status_code,
            {**kept, "Cache-Control": "no-store"},
            media_type=answer.headers.get("content-type", "application/json"),
        )

    return router


def _refused(visitor: Visitor, status: int) -> Response:
    """Return what a page is told where the API refuses whoever asks."""
    if not visitor.name:
        # 401 is the door's own word for "sign in": the browser must not take the API's for it.
        return _problem(
            403, "The API does not let this dashboard's key do that; ATRIUM_API_KEY needs a key with that scope."
        )
    if status == 401:
        visitor.ended = True
        return _problem(401, "Your sign-in has ended.")
    return _problem(403, f"You are signed in as {visitor.name} ({visitor.role}), who may not do that.")


def _problem(status: int, detail: str) -> JSONResponse:
    return JSONResponse({"status": status, "detail": detail}, status, {"Cache-Control": "no-store"})
