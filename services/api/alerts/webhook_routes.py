"""``/v1/webhooks``: whom alerts are sent to, what they did not take, and sending that again."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Annotated, TypeVar

import structlog
from fastapi import APIRouter, Query, Request
from sqlalchemy import Engine
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from services.api.alerts.receiver_address import AddressError, Network, Resolve, check_url
from services.api.alerts.webhook_replies import (
    DeadLetters,
    NewWebhook,
    Replayed,
    Webhook,
    WebhookDefinition,
    Webhooks,
)
from services.api.alerts.webhook_store import TooManyError, WebhookStore
from services.api.auth import needs
from services.api.database_away import database_away
from services.api.json_answer import json_answer
from services.api.openapi import GONE, created, documented, errors
from services.api.problems import Problem, ProblemError, unknown
from services.api.request_body import described, invalid, read_struct
from services.api.seen import ALL, saw
from shared.keys import is_identifier

__all__ = ["webhook_routes"]

log = structlog.get_logger(__name__)

LARGEST = 100_000
"""Bytes of a body."""
_ALLOWED = '{"url": "https://…", "name": "", "kinds": [], "zones": [], "enabled": true}'
_EXAMPLE = {"url": "https://alarm.example.org/atrium", "name": "Control room", "kinds": ["cross"], "zones": []}

T = TypeVar("T")


def webhook_routes(
    engine: Engine, store: WebhookStore, wake: Callable[[], None], allowed: Sequence[Network], resolve: Resolve
) -> APIRouter:
    """Return the routes.

    Args:
        engine: the database, for what is said when it is away.
        store: the webhooks.
        wake: called when there may be something to send.
        allowed: networks that may be private.
        resolve: a host's name and port → its addresses.
    """
    router = APIRouter(prefix="/v1/webhooks", tags=["webhooks"], default_response_class=Response)

    def asked(webhook: str, ask: Callable[[str], T]) -> T:
        try:
            if not is_identifier(webhook):
                raise KeyError(webhook)
            with database_away(engine):
                return ask(webhook)
        except KeyError:
            raise unknown("webhook", webhook) from None

    async def defined(request: Request) -> WebhookDefinition:
        needs(request.state.holder, "positions")  # messages name phones
        definition = await read_struct(request, WebhookDefinition, LARGEST, _ALLOWED)
        try:
            await check_url(definition.url, allowed, resolve)
        except AddressError as error:
            raise invalid("url", str(error), "https, to a host in no private network") from error
        return definition

    @router.get("", responses=documented(Webhooks, 503))
    def webhooks() -> Response:
        """All webhooks and how they are doing."""
        with database_away(engine):
            return json_answer(Webhooks(t=time.time(), webhooks=store.all()))

    @router.post(
        "",
        status_code=201,
        responses=created(NewWebhook, 409, 413, 422, 503),
        openapi_extra=described(WebhookDefinition, _EXAMPLE),
    )
    async def create(request: Request) -> Response:
        """Have alerts sent to a URL from now on; the answer holds the secret they are signed with, once.

        Needs the scope `positions` too, as alerts name phones.
        """
        definition = await defined(request)
        by: str = request.state.holder.name

        def write() -> NewWebhook:
            with database_away(engine):
                return store.create(definition, by, time.time())

        try:
            made = await run_in_threadpool(write)
        except TooManyError as error:
            raise ProblemError(
                Problem(type="urn:atrium:too-many-webhooks", title="Too many", status=409, detail=str(error))
            ) from error
        log.warning("a webhook was made", webhook=made.id, url=made.url, by=by)
        return json_answer(made, 201, {"Location": f"/v1/webhooks/{made.id}"})

    @router.get("/{webhook}", responses=documented(Webhook, 404, 503))
    def one(webhook: str) -> Response:
        """One webhook and how it is doing."""
        return json_answer(asked(webhook, store.one))

    @router.put(
        "/{webhook}",
        responses=documented(Webhook, 404, 413, 422, 503),
        openapi_extra=described(WebhookDefinition, _EXAMPLE),
    )
    async def change(webhook: str, request: Request) -> Response:
        """Change a webhook as a whole; its secret and what waits for it stay."""
        definition = await defined(request)
        told = await run_in_threadpool(asked, webhook, lambda name: store.change(name, definition))
        log.warning("a webhook was changed", webhook=webhook, url=told.url, by=request.state.holder.name)
        wake()
        return json_answer(told)

    @router.delete("/{webhook}", status_code=204, responses=GONE | errors(404, 503))
    def delete(webhook: str, request: Request) -> Response:
        """Delete a webhook and all that waits for it."""

        def drop(name: str) -> Webhook:
            was = store.one(name)
            store.delete(name)
            return was

        was = asked(webhook, drop)
        log.warning("a webhook was deleted", webhook=webhook, url=was.url, by=request.state.holder.name)
        return Response(status_code=204)

    @router.get("/{webhook}/dead", responses=documented(DeadLetters, 404, 422, 503))
    def dead(
        request: Request,
        webhook: str,
        after: Annotated[int, Query(ge=0, le=2**31 - 1, description="the next page: next of the answer before")] = 0,
        limit: Annotated[int, Query(ge=1, le=1000, description="at most this many")] = 100,
    ) -> Response:
        """What a webhook never took, oldest first, and why; needs the scope `positions` too, as it names phones."""
        needs(request.state.holder, "positions")
        saw(request, ALL)
        found = asked(webhook, lambda name: store.dead(name, after, limit + 1))
        following = found[limit - 1].id if len(found) > limit else None
        return json_answer(DeadLetters(t=time.time(), dead=found[:limit], next=following))

    @router.post("/{webhook}/replay", responses=documented(Replayed, 404, 422, 503))
    def replay(
        webhook: str,
        request: Request,
        letter: Annotated[
            int | None, Query(ge=1, le=2**31 - 1, description="only the dead letter of this id; by default all")
        ] = None,
    ) -> Response:
        """Send again what a webhook did not take."""
        replayed = asked(webhook, lambda name: store.replay(name, letter, time.time()))
        log.warning("dead letters are sent again", webhook=webhook, count=replayed, by=request.state.holder.name)
        wake()
        return json_answer(Replayed(replayed=replayed))

    return router
