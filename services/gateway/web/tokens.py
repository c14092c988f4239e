"""Tokens for other apps: handed out with fewer rights, listed by id, revoked."""

from __future__ import annotations

import time

from fastapi import APIRouter, Request, Response

from services.gateway.devices.known_tokens import Grant
from services.gateway.devices.tokens import MANAGE, TokenSigner
from services.gateway.errors import read_json, refuse
from services.gateway.protocol import NewToken, TokenEntry, TokenRequest, Tokens
from services.gateway.web.bodies import header
from services.gateway.web.gateway import Gateway
from services.gateway.web.intake import Intake
from services.gateway.web.openapi import answers, takes
from services.gateway.web.replies import respond
from services.gateway.web.stream import Streams
from services.gateway.web.who_asks import WhoAsks, bearer
from shared.keys import is_identifier

__all__ = ["token_routes"]

REQUEST_BYTES = 4096
SHORTEST = 60.0
"""Seconds that a token handed out is valid at least."""
MOST_TOKENS = 20
"""Valid at once, of one device."""


def token_routes(
    gateway: Gateway, who_asks: WhoAsks, intake: Intake, signer: TokenSigner, streams: Streams
) -> APIRouter:
    """Return the routes about a device's tokens; all need the scope ``manage``."""
    router = APIRouter()

    async def asking(request: Request, device: str) -> Grant:
        grant = await who_asks.grant(bearer(header(request.scope, b"authorization")), device, MANAGE)
        intake.admit(device)
        return grant

    @router.post(
        "/v1/devices/{device}/tokens",
        status_code=201,
        openapi_extra=takes(TokenRequest),
        responses=answers(201, NewToken, 400, 401, 403, 404, 408, 413, 415, 422, 429, 503),
    )
    async def hand_out(device: str, request: Request) -> Response:
        """Hand out a token for another app, which may do less. Scope: `manage`."""
        grant = await asking(request, device)
        body = read_json(await gateway.bodies.read(device, request.scope, request.receive, REQUEST_BYTES), TokenRequest)
        now = time.time()
        wanted = list(dict.fromkeys(body.scopes))
        beyond = [scope for scope in wanted if scope not in grant.claims.scopes]
        if beyond:
            allowed = " ".join(sorted(grant.claims.scopes))
            refuse("scopes", "more than the token that asks may do itself", " ".join(beyond), allowed, 403)
        expires = grant.claims.expires if body.seconds is None else min(now + body.seconds, grant.claims.expires)
        if expires < now + SHORTEST:
            refuse("seconds", "the token that asks ends too soon", expires - now, f"{SHORTEST:g} s or more")
        if len(await gateway.work(gateway.store.tokens, device, now)) >= MOST_TOKENS:
            refuse("scopes", "this device has too many tokens", MOST_TOKENS, "revoke one first")
        token = await gateway.work(gateway.store.add_token, device, now, wanted, expires)
        made = NewToken(
            id=token.id, token=signer.sign(device, token.id, wanted, expires), scopes=wanted, expires=expires
        )
        return respond(made, 201)

    @router.get("/v1/devices/{device}/tokens", responses=answers(200, Tokens, 401, 403, 404, 429, 503))
    async def show(device: str, request: Request) -> Response:
        """List the tokens that are valid now, by id. Scope: `manage`."""
        grant = await asking(request, device)
        tokens = await gateway.work(gateway.store.tokens, device, time.time())
        return respond(
            Tokens(
                tokens=[
                    TokenEntry(
                        id=token.id,
                        scopes=list(token.scopes),
                        created=token.created,
                        expires=token.expires,
                        asking=token.id == grant.claims.id,
                    )
                    for token in tokens
                ]
            )
        )

    @router.delete(
        "/v1/devices/{device}/tokens/{token}", status_code=204, responses=answers(204, None, 401, 403, 404, 429, 503)
    )
    async def revoke(device: str, token: str, request: Request) -> Response:
        """Revoke one token by its id; it is dead at once. Scope: `manage`."""
        await asking(request, device)
        known = is_identifier(token) and await gateway.work(gateway.store.revoke_token, device, token, time.time())
        who_asks.forget(device, token)
        if not known:
            refuse("token", "is none of this device's", token, "an id from the list of tokens", 404)
        gateway.receivers.expect_news()  # the last token of a device lets its transmitters go
        await streams.close(device, "the token was revoked", token)
        return Response(status_code=204)

    return router
