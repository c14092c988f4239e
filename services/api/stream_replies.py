"""How a reader's events leave: as the body of an answer or as messages of a WebSocket, both with bounded patience.

The body is written here and not by the framework's streaming answer, which waits for ever for a client that stopped
reading.
"""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass

import structlog
from starlette.responses import Response
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from services.api.event_log import Framing, ndjson_event, sse_event
from services.api.stream import DROPPED, Hub, Reader
from shared.http_server import timed_out

__all__ = ["NDJSON", "SSE", "Dialect", "StreamResponse", "converse"]

log = structlog.get_logger(__name__)

CLOSE_CODES = {401: 1008, 410: 1013, 503: 1001}
"""Of a WebSocket, by the status that the last word has: not allowed, try again later, going away."""


@dataclass(frozen=True, slots=True)
class Dialect:
    """How events travel over HTTP.

    Attributes:
        media_type: of the body.
        framing: of one event.
        opening: what is sent first.
        silence: what is sent when there is nothing to tell for a while.
    """

    media_type: str
    framing: Framing
    opening: bytes
    silence: bytes


SSE = Dialect("text/event-stream", sse_event, b": atrium stream\nretry: 1000\n\n", b": still here\n\n")
NDJSON = Dialect("application/x-ndjson", ndjson_event, b"", b"\n")


class StreamResponse(Response):
    """Everything one reader is told, until it leaves, is closed or takes nothing for ``patience`` seconds."""

    def __init__(self, hub: Hub, reader: Reader, dialect: Dialect, first: list[bytes], patience: float) -> None:
        super().__init__(
            media_type=dialect.media_type,
            headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no", "Vary": "Accept"},
        )
        del self.headers["content-length"]
        self._hub, self._reader, self._dialect = hub, reader, dialect
        self._first = dialect.opening + b"".join(first)
        self._patience = patience

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Write the answer."""
        gone = asyncio.create_task(self._gone(receive))
        stalled = False
        try:
            await send({"type": "http.response.start", "status": 200, "headers": self.raw_headers})
            await self._send(send, self._first)
            async for chunk in self._reader.chunks():
                await self._send(send, chunk or self._dialect.silence)
            await self._send(send, b"", more=False)
        except TimeoutError:
            stalled = True
        finally:
            gone.cancel()
            self._hub.leave(self._reader)
        if stalled or timed_out(scope):
            _stalled(self._patience)

    async def _send(self, send: Send, body: bytes, more: bool = True) -> None:
        async with asyncio.timeout(self._patience):
            await send({"type": "http.response.body", "body": body, "more_body": more})

    async def _gone(self, receive: Receive) -> None:
        while (await receive())["type"] != "http.disconnect":
            pass
        self._reader.close()


async def converse(websocket: WebSocket, hub: Hub, reader: Reader, first: list[bytes], patience: float) -> None:
    """Send a reader's events as text messages over an accepted WebSocket, until either end leaves."""

    async def gone() -> None:
        # What a client says is read and ignored, so that its leaving is heard.
        while (await websocket.receive())["type"] != "websocket.disconnect":
            pass
        reader.close()

    watching = asyncio.create_task(gone())
    stalled = False
    try:
        for event in first:
            await _tell(websocket, event, patience)
        async for chunk in reader.chunks():
            for line in chunk.splitlines():
                await _tell(websocket, line, patience)
        with contextlib.suppress(RuntimeError, WebSocketDisconnect):
            async with asyncio.timeout(patience):
                await websocket.close(CLOSE_CODES[reader.ended.status] if reader.ended is not None else 1000)
    except TimeoutError:
        stalled = True
    except (WebSocketDisconnect, RuntimeError):
        pass  # the client left
    finally:
        watching.cancel()
        hub.leave(reader)
    if stalled or timed_out(websocket.scope):
        _stalled(patience)


def _stalled(patience: float) -> None:
    """Count a client that took nothing: much waited for it here, or little for twice as long in the system."""
    DROPPED.labels("stalled").inc()
    log.info("a stream was ended: its client reads nothing", patience=patience)


async def _tell(websocket: WebSocket, event: bytes, patience: float) -> None:
    async with asyncio.timeout(patience):
        await websocket.send_text(event.strip().decode())
