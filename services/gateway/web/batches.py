"""``POST /v1/devices/{device}/batches``: the one route that every phone uses every second, kept as light as ASGI is."""

from __future__ import annotations

import time

from starlette.types import Receive, Scope, Send

from services.gateway.devices.tokens import POST
from services.gateway.web.bodies import OpenBodies, header
from services.gateway.web.intake import Intake
from services.gateway.web.replies import encode
from services.gateway.web.who_asks import WhoAsks, bearer

__all__ = ["BatchRoute"]

JSON = (b"content-type", b"application/json")


class BatchRoute:
    """An ASGI application for one path; errors are left to the application around it."""

    def __init__(self, who_asks: WhoAsks, intake: Intake, bodies: OpenBodies, limit: int) -> None:
        self._who_asks = who_asks
        self._intake = intake
        self._bodies = bodies
        self._limit = limit

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Take what a phone measured; the reply is sent once all of it is on the bus."""
        received = time.time()
        device = scope["path_params"]["device"]
        token = bearer(header(scope, b"authorization"))
        grant = await self._who_asks.grant(token, device, POST)
        self._intake.admit(device)
        batch = await self._bodies.read(device, scope, receive, self._limit)
        if not self._who_asks.still_holds(token, grant):  # the consent may have been withdrawn while the body came
            grant = await self._who_asks.grant(token, device, POST)
        reply = await self._intake.take(grant.device, batch, received)
        body = encode(reply)
        await send(
            {
                "type": "http.response.start",
                "status": 202 if reply.late else 200,
                "headers": [JSON, (b"content-length", b"%d" % len(body))],
            }
        )
        await send({"type": "http.response.body", "body": body})
