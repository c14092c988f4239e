"""Answer the reads that are asked for most straight from their ready-made bytes.

An ASGI layer behind the keys and before the framework: routing, parameters and response objects would cost more than
the answer. The same paths stand in the application too, where they are documented; both ask the same source.
"""

from __future__ import annotations

import itertools
import secrets
import time
from collections.abc import Callable, Mapping
from types import MappingProxyType

from starlette.types import ASGIApp, Receive, Scope, Send

from services.api.auth import Holder
from services.api.seen import ALL

__all__ = ["HotReads"]


class _Source:
    """One body that is built anew only when it changes, and the headers that go with it.

    A body's tag is a number: sources hand out the very same object as long as nothing changed, so nothing is hashed.
    """

    __slots__ = ("_body", "_build", "_headers", "_run", "tag")

    def __init__(self, build: Callable[[float], bytes], run: str) -> None:
        self._build = build
        self._run = run
        self._body: bytes | None = None
        self._headers: list[tuple[bytes, bytes]] = []
        self.tag = b""

    def at(self, now: float) -> tuple[bytes, list[tuple[bytes, bytes]]]:
        body = self._build(now)
        if body is not self._body:
            self._body = body
            self.tag = f'"{self._run}{next(_numbers)}"'.encode()
            self._headers = [
                (b"content-type", b"application/json"),
                (b"content-length", str(len(body)).encode()),
                (b"etag", self.tag),
                (b"cache-control", b"no-cache"),
                (b"vary", b"Accept"),
            ]
        return body, self._headers


_numbers = itertools.count(1)


class HotReads:
    """ASGI layer that answers ``GET path`` without a query by ``sources[path](now)``, a JSON body with an ETag.

    Whoever names the present tag in ``If-None-Match`` gets 304 and no body. Who accepts GeoJSON is handed on. The audit
    layer hears of reads of paths in ``naming``, which name people. Of paths in ``only_for`` others are handed on, too.
    """

    def __init__(
        self,
        app: ASGIApp,
        sources: Mapping[str, Callable[[float], bytes]],
        naming: frozenset[str] = frozenset(),
        only_for: Mapping[str, Callable[[Holder], bool]] = MappingProxyType({}),
    ) -> None:
        self._app = app
        self._naming = naming
        self._only_for = only_for
        run = f"{secrets.token_hex(3)}-"
        self._sources = {path: _Source(build, run) for path, build in sources.items()}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or hand the request on."""
        source = self._sources.get(scope["path"]) if scope["type"] == "http" else None
        if source is None or scope["method"] != "GET" or scope["query_string"]:
            await self._app(scope, receive, send)
            return
        only_for = self._only_for.get(scope["path"])
        if only_for is not None and not only_for(scope["state"]["holder"]):
            await self._app(scope, receive, send)
            return
        held = None
        for name, value in scope["headers"]:
            if name == b"if-none-match":
                held = value
            elif name == b"accept" and b"geo+json" in value:
                await self._app(scope, receive, send)
                return
        if scope["path"] in self._naming:
            scope.setdefault("state", {})["audit_seen"] = ALL
        body, headers = source.at(time.time())
        if held is not None and source.tag in [tag.strip().removeprefix(b"W/") for tag in held.split(b",")]:
            await send({"type": "http.response.start", "status": 304, "headers": headers[2:]})
            await send({"type": "http.response.body", "body": b""})
            return
        # A copy: layers around this one may add headers of their own to it.
        await send({"type": "http.response.start", "status": 200, "headers": [*headers]})
        await send({"type": "http.response.body", "body": body})
