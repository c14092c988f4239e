"""What a phone reads and changes of itself: position, alerts, how it is carried, and the end of its consent."""

from __future__ import annotations

import time

from fastapi import APIRouter, Request, Response

from services.gateway.devices.tokens import POST, READ
from services.gateway.errors import read_json, refuse
from services.gateway.protocol import Change, OwnAlerts, OwnDevice, Position
from services.gateway.web.bodies import header
from services.gateway.web.gateway import Gateway
from services.gateway.web.intake import Intake
from services.gateway.web.openapi import answers, takes
from services.gateway.web.replies import respond
from services.gateway.web.who_asks import WhoAsks, bearer
from services.gateway.web.withdrawal import Withdrawal

__all__ = ["own_data_routes"]

CHANGE_BYTES = 4096


def own_data_routes(gateway: Gateway, who_asks: WhoAsks, intake: Intake, withdrawal: Withdrawal) -> APIRouter:
    """Return the routes of one device about itself."""
    router = APIRouter()

    async def allow(request: Request, device: str, scope: str) -> None:
        await who_asks.grant(bearer(header(request.scope, b"authorization")), device, scope)

    @router.get("/v1/devices/{device}/position", responses=answers(200, Position, 401, 403, 404, 503))
    async def own_position(device: str, request: Request) -> Response:
        """Tell a phone where it is itself, and in which zones. Scope: `read`."""
        await allow(request, device, READ)
        position = gateway.positions.of(device, time.time())
        if position is None:
            refuse("device", "not located yet: no camera track carries this device", status=404)
        return respond(position)

    @router.get("/v1/devices/{device}/alerts", responses=answers(200, OwnAlerts, 401, 403, 404, 503))
    async def own_alerts(device: str, request: Request) -> Response:
        """Tell a phone which zones it entered and left lately, the last 50. Scope: `read`."""
        await allow(request, device, READ)
        return respond(OwnAlerts(alerts=gateway.alerts.of(device)))

    @router.patch(
        "/v1/devices/{device}",
        openapi_extra=takes(Change),
        responses=answers(200, OwnDevice, 400, 401, 403, 404, 408, 413, 415, 422, 429, 503),
    )
    async def change(device: str, request: Request) -> Response:
        """Change how the phone is carried. Scope: `post`, as the app that measures knows."""
        await allow(request, device, POST)
        intake.admit(device)
        body = read_json(await gateway.bodies.read(device, request.scope, request.receive, CHANGE_BYTES), Change)
        await gateway.work(gateway.store.carry, device, body.carrying)
        who_asks.forget(device)
        return respond(OwnDevice(device=device, carrying=body.carrying))

    @router.delete("/v1/devices/{device}", status_code=204, responses=answers(204, None, 401, 403, 404, 503))
    async def withdraw(device: str, request: Request) -> Response:
        """Take the consent back: all tokens die at once and the device is forgotten. Scope: `manage`.

        A token may do so for 30 days after its end too.
        """
        await who_asks.withdrawing(bearer(header(request.scope, b"authorization")), device)
        await withdrawal.carry_out(device)
        return Response(status_code=204)

    return router
