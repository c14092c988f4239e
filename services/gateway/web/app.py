"""The gateway's HTTP application, assembled: one module per resource, one form of errors, one page."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI
from fastapi_offline import FastAPIOffline
from starlette.routing import Route, WebSocketRoute

from services.gateway.adapters.routes import adapter_routes
from services.gateway.devices.tokens import TokenSigner, keys_of
from services.gateway.web.batches import BatchRoute
from services.gateway.web.enrolment import enrolment_routes
from services.gateway.web.gateway import Gateway
from services.gateway.web.intake import Intake
from services.gateway.web.openapi import complete
from services.gateway.web.own_data import own_data_routes
from services.gateway.web.own_record import own_record_routes
from services.gateway.web.replies import report_errors
from services.gateway.web.schemas import BODIES, schema_routes
from services.gateway.web.stream import Streams
from services.gateway.web.tokens import token_routes
from services.gateway.web.trial_walks import trial_walk_routes
from services.gateway.web.who_asks import WhoAsks
from services.gateway.web.withdrawal import Withdrawal
from shared.bus import Question

__all__ = ["create_app"]


def create_app(gateway: Gateway) -> FastAPI:
    """Return the application."""
    settings = gateway.settings
    signer = TokenSigner(keys_of(settings.token_key.get_secret_value()))
    who_asks = WhoAsks(gateway, signer)
    intake = Intake(gateway)
    streams = Streams(who_asks, intake, settings.batch_bytes)
    withdrawal = Withdrawal(gateway, who_asks, streams)

    @asynccontextmanager
    async def life(_app: FastAPI) -> AsyncIterator[None]:
        loop = asyncio.get_running_loop()

        def take(order: Question) -> None:
            loop.call_soon_threadsafe(withdrawal.take, order)

        gateway.bus.answer_questions(gateway.keys.withdrawal(), take)
        gateway.started()
        yield
        gateway.close()

    app = FastAPIOffline(
        redoc_url=None,
        title="Atrium gateway",
        summary="Where phones post what they measure and read where they are.",
        version="1",
        lifespan=life,
    )
    # First, since every phone asks for it every second.
    batches = BatchRoute(who_asks, intake, gateway.bodies, settings.batch_bytes)
    app.router.routes.insert(0, Route("/v1/devices/{device}/batches", batches, methods=["POST"]))
    app.router.routes.append(WebSocketRoute("/v1/devices/{device}/stream", streams.serve))
    for router in (
        enrolment_routes(gateway, signer),
        own_data_routes(gateway, who_asks, intake, withdrawal),
        own_record_routes(gateway, who_asks),
        token_routes(gateway, who_asks, intake, signer, streams),
        trial_walk_routes(gateway, who_asks, intake),
        adapter_routes(gateway, who_asks, intake),
        schema_routes(),
    ):
        app.include_router(router)
    complete(app, BODIES)
    report_errors(app)
    return app
