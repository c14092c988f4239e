"""What stands in this request's body? Plain or compressed, never more of it held than is allowed."""

from __future__ import annotations

import asyncio
import zlib
from collections import Counter
from typing import NoReturn

from starlette.requests import ClientDisconnect
from starlette.types import Receive, Scope

from services.gateway.errors import RequestError, refuse
from services.gateway.protocol import FieldError

__all__ = ["OpenBodies", "header", "read_body"]

DISCARD = 1 << 25
"""Bytes of an oversized body read and thrown away, so that its sender sees the answer, not a broken pipe."""
WINDOW_BITS = {"gzip": 31, "x-gzip": 31, "deflate": 15}
"""For zlib; what HTTP calls deflate is zlib's own format (RFC 9110, section 8.4.1.2)."""


def header(scope: Scope, name: bytes) -> str:
    """Return the value of one header, empty where it is missing; ``name`` is in lower case."""
    for key, value in scope["headers"]:
        if key == name:
            text: str = value.decode("latin-1")
            return text
    return ""


class OpenBodies:
    """How many bodies of each sender are on their way; touched by the event loop only.

    Args:
        most: at once, of one sender.
        seconds: within which a body must have come.
    """

    def __init__(self, most: int, seconds: float) -> None:
        self._most = most
        self._seconds = seconds
        self._open: Counter[str] = Counter()

    async def read(self, sender: str, scope: Scope, receive: Receive, limit: int) -> bytes:
        """Return the body of one sender's request; see ``read_body``.

        Raises:
            RequestError: also 429 where too many of this sender's are open, 408 where it is too slow.
        """
        if self._open[sender] >= self._most:
            problem = FieldError(field="body", problem="too many open requests", allowed=f"{self._most} at once")
            raise RequestError(429, problem, headers={"Retry-After": "1"})
        self._open[sender] += 1
        try:
            async with asyncio.timeout(self._seconds):
                return await read_body(scope, receive, limit)
        except TimeoutError as error:
            problem = FieldError(field="body", problem="came too slowly", allowed=f"within {self._seconds:g} s")
            raise RequestError(408, problem, headers={"Connection": "close"}) from error
        finally:
            self._open[sender] -= 1
            if not self._open[sender]:
                del self._open[sender]


async def read_body(scope: Scope, receive: Receive, limit: int) -> bytes:
    """Return the body of a request, decompressed where it came compressed.

    Args:
        scope: of the request.
        receive: brings its body.
        limit: bytes; neither what is sent nor what it unpacks to may be larger.

    Raises:
        RequestError: 413 where it is too large, 415 for an unknown compression, 400 for a broken one.
        ClientDisconnect: the sender went away.
    """
    encoding = header(scope, b"content-encoding").strip().lower() or "identity"
    if encoding != "identity" and encoding not in WINDOW_BITS:
        refuse("Content-Encoding", "is not taken", encoding, "gzip, deflate or none", 415)
    declared = header(scope, b"content-length")
    claimed = int(declared) if declared.isdigit() else 0
    too_large = claimed > limit
    chunks: list[bytes] = []
    size = 0
    more = True
    while more:
        message = await receive()
        if message["type"] == "http.disconnect":
            raise ClientDisconnect
        chunk: bytes = message.get("body", b"")
        more = message.get("more_body", False)
        size += len(chunk)
        too_large = too_large or size > limit
        if not too_large:
            chunks.append(chunk)
            continue
        chunks.clear()
        if max(size, claimed) > DISCARD:
            break
    if too_large:
        _refuse_size(f"{declared or size} bytes" + ("" if declared else " and more"), limit)
    body = chunks[0] if len(chunks) == 1 else b"".join(chunks)
    return body if encoding == "identity" else unpacked(body, encoding, limit)


def unpacked(body: bytes, encoding: str, limit: int) -> bytes:
    """Return what a compressed body holds; unpacking stops at the limit, whatever the body claims to hold.

    Raises:
        RequestError: 413 where it would be more than ``limit`` bytes, 400 where it cannot be unpacked.
    """
    stream = zlib.decompressobj(WINDOW_BITS[encoding])
    try:
        plain = stream.decompress(body, limit + 1)
    except zlib.error as error:
        refuse("body", f"is not {encoding}", str(error), f"{encoding}, as Content-Encoding says", 400)
    if len(plain) > limit:
        _refuse_size(f"{len(body)} bytes that unpack to more", limit)
    if not stream.eof or stream.unused_data:
        found = "it ends too early" if not stream.eof else f"{len(stream.unused_data)} bytes after its end"
        refuse("body", f"is not {encoding}", found, "one whole stream", 400)
    return plain


def _refuse_size(found: str, limit: int) -> NoReturn:
    problem = FieldError(field="body", problem="is too large", found=found, allowed=f"at most {limit} bytes")
    raise RequestError(413, problem, headers={"Connection": "close"})
