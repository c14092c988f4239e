"""Carries what the set-up pages ask to the API, for whoever asks; no browser ever sees a key or token."""

from __future__ import annotations

import httpx
import structlog
from fastapi import FastAPI, Request
from fastapi.responses import JSONResponse, Response

from services.dashboard.sessions import asked_by
from shared.keys import is_identifier

__all__ = ["add_setup_relay"]

log = structlog.get_logger(__name__)

OF_CAMERA = {"GET": ("still", "board", "calibration"), "POST": ("still", "calibration", "calibration/try")}
OF_SITE = {"GET": ("site", "access-points"), "POST": ("access-points",)}
LARGEST = 1 << 20
"""Bytes of what a browser may send."""
PATIENCE = 20.0
PASSED_ON = ("content-type", "cache-control", "retry-after", "x-atrium-taken")


def add_setup_relay(app: FastAPI, api_url: str, api_key: str) -> None:
    """Add ``/setup/…`` to ``app``: only what the pages need, and nothing a form of another site could send.

    Args:
        app: the web application, behind its door.
        api_url: without a slash at the end.
        api_key: the dashboard's own, sent for whoever did not sign in by name.
    """

    async def carry(request: Request, path: str) -> Response:
        visitor, body = asked_by(request, api_key), bytearray()
        if request.method == "POST":
            if request.headers.get("content-type", "").split(";")[0] != "application/json":
                return JSONResponse({"detail": "the body must be JSON (application/json)"}, 415)
            async for chunk in request.stream():
                body += chunk
                if len(body) > LARGEST:
                    return JSONResponse({"detail": f"the body is larger than {LARGEST} bytes"}, 413)
        try:
            # The address comes from the operator: proxies of the environment are not for it.
            headers = {"Authorization": f"Bearer {visitor.key}"}
            async with httpx.AsyncClient(headers=headers, timeout=PATIENCE, trust_env=False) as client:
                answer = await client.request(
                    request.method,
                    f"{api_url}/v1/{path}",
                    params=str(request.query_params),
                    content=bytes(body),
                )
        except httpx.HTTPError as error:
            log.debug("no answer", error=repr(error))
            return JSONResponse({"detail": "the API does not answer; is it running?"}, 502)
        if answer.status_code == 401 and visitor.name:
            visitor.ended = True
            return JSONResponse({"detail": "your sign-in has ended"}, 401)
        if answer.status_code == 401:
            # Not the browser's session: that one is let in.
            return JSONResponse({"detail": "the API does not know this dashboard's key"}, 502)
        return Response(
            answer.content,
            answer.status_code,
            {name: answer.headers[name] for name in PASSED_ON if name in answer.headers},
        )

    @app.api_route("/setup/cameras/{camera}/{what:path}", methods=["GET", "POST"])
    async def of_camera(request: Request, camera: str, what: str) -> Response:
        """Carry what is asked of one camera."""
        if not is_identifier(camera) or what not in OF_CAMERA[request.method]:
            return JSONResponse({"detail": "there is nothing here"}, 404)
        return await carry(request, f"cameras/{camera}/{what}")

    @app.api_route("/setup/{what}", methods=["GET", "POST"])
    async def of_site(request: Request, what: str) -> Response:
        """Carry what is asked of the site."""
        if what not in OF_SITE[request.method]:
            return JSONResponse({"detail": "there is nothing here"}, 404)
        return await carry(request, what)
