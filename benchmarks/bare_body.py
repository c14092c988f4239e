"""What the API's reads are measured against: endpoints that answer the same ready-made bytes and do no more."""

from __future__ import annotations

import sys
import threading

from fastapi import FastAPI
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from shared.http_server import serve

__all__ = ["PLAIN", "BareBody"]

PLAIN = "/plain"


class BareBody:
    """ASGI application that answers ``body``, JSON: below ``/plain`` by itself, elsewhere by a route of FastAPI."""

    def __init__(self, body: bytes) -> None:
        self._body = body
        self._headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode())]
        self._framework = FastAPI()

        @self._framework.get("/{path:path}")
        async def read(path: str) -> Response:
            return Response(body, media_type="application/json")

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer."""
        if scope["type"] != "http" or scope["path"] != PLAIN:
            await self._framework(scope, receive, send)
            return
        await send({"type": "http.response.start", "status": 200, "headers": self._headers})
        await send({"type": "http.response.body", "body": self._body})


if __name__ == "__main__":
    serve(BareBody(sys.stdin.buffer.read()), "127.0.0.1", int(sys.argv[1]), threading.Event())
