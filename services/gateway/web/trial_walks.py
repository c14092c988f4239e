"""``PUT /v1/devices/{device}/trial-walks``: a person's own step thresholds and stride line, used from now on."""

from __future__ import annotations

import time

from fastapi import APIRouter, Request, Response

from services.gateway.devices.tokens import MANAGE
from services.gateway.devices.trial_walks import learn_from
from services.gateway.errors import read_json
from services.gateway.protocol import TrialWalks, TrialWalksReply
from services.gateway.web.bodies import header
from services.gateway.web.gateway import Gateway
from services.gateway.web.intake import Intake
from services.gateway.web.openapi import answers, takes
from services.gateway.web.replies import respond
from services.gateway.web.who_asks import WhoAsks, bearer

__all__ = ["trial_walk_routes"]

WALKS = 2
"""Batches' worth of bytes that a body may have: a walk is as long as the longest batch at most."""


def trial_walk_routes(gateway: Gateway, who_asks: WhoAsks, intake: Intake) -> APIRouter:
    """Return the route."""
    router = APIRouter()
    settings = gateway.settings

    @router.put(
        "/v1/devices/{device}/trial-walks",
        openapi_extra=takes(TrialWalks),
        responses=answers(200, TrialWalksReply, 400, 401, 403, 404, 408, 413, 415, 422, 429, 503),
    )
    async def put(device: str, request: Request) -> Response:
        """Learn how this phone's carrier walks, from one or two straight walks of known length. Scope: `manage`."""
        token = bearer(header(request.scope, b"authorization"))
        await who_asks.grant(token, device, MANAGE)
        intake.admit(device)
        content = await gateway.bodies.read(device, request.scope, request.receive, WALKS * settings.batch_bytes)
        body = read_json(content, TrialWalks)
        walker, found = await gateway.work(learn_from, body, settings.limits())
        await who_asks.grant(token, device, MANAGE)  # the consent may have been withdrawn meanwhile
        await gateway.work(gateway.store.keep_walker, device, walker, time.time())
        who_asks.forget(device)
        reply = TrialWalksReply(
            peak=walker.peak or 0.0, mean=walker.mean or 0.0, slope=walker.slope, offset=walker.offset, walks=found
        )
        return respond(reply)

    return router
