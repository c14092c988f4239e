"""Answer the reads that are asked for most straight from their ready-made bytes.

An ASGI layer behind the keys and before the framework: routing, parameters and response objects would cost more than
the answer. The same paths stand in the application too, where they are documented; both ask the same source.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from starlette.types import ASGIApp, Receive, Scope, Send

__all__ = ["HotReads"]


class HotReads:
    """ASGI layer that answers ``GET path`` without a query by ``sources[path](now)``, a JSON body."""

    def __init__(self, app: ASGIApp, sources: Mapping[str, Callable[[float], bytes]]) -> None:
        self._app = app
        self._sources = sources

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or hand the request on."""
        source = self._sources.get(scope["path"]) if scope["type"] == "http" else None
        if source is None or scope["method"] != "GET" or scope["query_string"]:
            await self._app(scope, receive, send)
            return
        body = source(time.time())
        headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode())]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": body})
