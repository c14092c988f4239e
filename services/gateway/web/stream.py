"""``/v1/devices/{device}/stream``: the same batches over a WebSocket, one reply to each frame, in order.

The next frame is read only when the one before has been answered: an app that sends faster than the gateway takes is
held back by its own connection.
"""

from __future__ import annotations

import contextlib
import time

import msgspec
import structlog
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from services.gateway.devices.known_tokens import Grant
from services.gateway.devices.tokens import POST
from services.gateway.errors import RequestError
from services.gateway.protocol import FieldError
from services.gateway.web.intake import Intake
from services.gateway.web.replies import encode, error_of, refusal
from services.gateway.web.who_asks import WhoAsks, bearer

__all__ = ["Streams"]

SUBPROTOCOL = "atrium"
MOST_STREAMS = 4
"""Open at once, of one device."""
UNAUTHORISED = 4401
"""Close code: the token is no longer valid."""

log = structlog.get_logger(__name__)


class Streams:
    """The open streams of all devices; touched by the event loop only.

    Args:
        who_asks: looks at tokens.
        intake: takes batches.
        limit: bytes of a frame.
    """

    def __init__(self, who_asks: WhoAsks, intake: Intake, limit: int) -> None:
        self._who_asks = who_asks
        self._intake = intake
        self._limit = limit
        self._open: dict[str, dict[WebSocket, str]] = {}

    async def serve(self, websocket: WebSocket) -> None:
        """Take batches from one app until it, or its token, goes."""
        device = websocket.path_params["device"]
        try:
            token = _token(websocket)
            grant = await self._who_asks.grant(token, device, POST)
            if len(self._open.get(device, ())) >= MOST_STREAMS:
                problem = FieldError(field="", problem="too many streams of this device", allowed=f"{MOST_STREAMS}")
                raise RequestError(429, problem, headers={"Retry-After": "10"})
        except Exception as error:
            await websocket.send_denial_response(refusal(error_of(error)))
            return
        offered = websocket.scope["subprotocols"]
        await websocket.accept(SUBPROTOCOL if SUBPROTOCOL in offered else None)
        streams = self._open.setdefault(device, {})
        streams[websocket] = grant.claims.id
        try:
            # Whoever closed the stream meanwhile has told the app why.
            with contextlib.suppress(WebSocketDisconnect, RuntimeError):
                await self._converse(websocket, device, token, grant)
        finally:
            del streams[websocket]
            if not streams:
                self._open.pop(device, None)

    async def close(self, device: str, reason: str, token_id: str | None = None) -> None:
        """Close the streams of a device that one of its tokens opened, or all of them."""
        for websocket, opened_by in list(self._open.get(device, {}).items()):
            if token_id in (None, opened_by) and websocket.application_state is WebSocketState.CONNECTED:
                with contextlib.suppress(WebSocketDisconnect, RuntimeError):
                    await websocket.close(UNAUTHORISED, reason)

    async def _converse(self, websocket: WebSocket, device: str, token: str, grant: Grant) -> None:
        while True:
            message = await websocket.receive()
            received = time.time()
            if message["type"] == "websocket.disconnect":
                return
            text = message.get("text")
            batch: bytes = message["bytes"] if text is None else text.encode()
            try:
                if not self._who_asks.still_holds(token, grant):
                    grant = await self._who_asks.grant(token, device, POST)
                self._intake.admit(device)
                reply: msgspec.Struct = await self._intake.take(grant.device, batch, received)
            except Exception as error:
                refused = error_of(error)
                if refused.status == 500:
                    log.exception("a batch of a stream failed", device=device)
                refusal(refused)
                await websocket.send_text(encode(refused.reply).decode())
                if refused.status in (401, 403, 404):
                    await websocket.close(UNAUTHORISED, "the token is no longer valid")
                    return
                continue
            await websocket.send_text(encode(reply).decode())


def _token(websocket: WebSocket) -> str:
    """Return the token from the header, the query, or the subprotocols (``atrium, TOKEN``): a browser has no header."""
    offered: list[str] = websocket.scope["subprotocols"]
    if len(offered) == 2 and SUBPROTOCOL in offered:
        return next(name for name in offered if name != SUBPROTOCOL)
    if "token" in websocket.query_params:
        return websocket.query_params["token"]
    return bearer(websocket.headers.get("authorization", ""))
