"""Who asks, and may they? A token's signature first, then whether it was revoked, then whose it is and its scope."""

from __future__ import annotations

import time
from typing import NoReturn

from services.gateway.devices.known_tokens import Grant, KnownTokens
from services.gateway.devices.tokens import MANAGE, WITHDRAWABLE, TokenSigner
from services.gateway.errors import RequestError, refuse
from services.gateway.protocol import FieldError
from services.gateway.web.gateway import Gateway
from shared.keys import is_identifier

__all__ = ["WhoAsks", "bearer"]


def bearer(authorization: str) -> str:
    """Return the token of an ``Authorization`` header.

    Raises:
        RequestError: 401 where there is none.
    """
    kind, _, token = authorization.partition(" ")
    if kind.lower() != "bearer" or not token.strip():
        _refuse_token()
    return token.strip()


class WhoAsks:
    """Looks at tokens; touched by the event loop only."""

    def __init__(self, gateway: Gateway, signer: TokenSigner) -> None:
        self._gateway = gateway
        self._signer = signer
        self._known = KnownTokens(gateway.settings.token_recheck)

    async def grant(self, token: str, device: str, scope: str) -> Grant:
        """Return whose token this is, if it may do this with this device.

        Args:
            token: as sent.
            device: in the path.
            scope: what is asked for.

        Raises:
            RequestError: 401 for a token that is not valid, 403 for another device's or one that may not do this, 404
                for a device that is not enrolled.
        """
        found = self._known.get(token) or await self._ask(token)
        if found.device.id != device:
            if is_identifier(device) and await self._gateway.work(self._gateway.store.exists, device):
                refuse("device", "the token is another device's", status=403)
            refuse("device", "is not enrolled", found=device, status=404)
        return _allowed(found, scope)

    async def withdrawing(self, token: str, device: str) -> None:
        """Let a token withdraw its device's consent, even for a while after its end; errors as of ``grant``."""
        claims = self._signer.read(token, time.time() - WITHDRAWABLE)
        if claims is None or claims.expires > time.time() or claims.device != device:
            await self.grant(token, device, MANAGE)
            return
        registered = await self._gateway.work(self._gateway.store.by_token, claims.id)
        if registered is None or registered.id != device:
            _refuse_token()
        _allowed(Grant(claims, registered), MANAGE)

    async def owner(self, token: str, scope: str) -> Grant:
        """Return whose token this is, if it may do this, where the path names no device; see ``grant``."""
        return _allowed(self._known.get(token) or await self._ask(token), scope)

    def still_holds(self, token: str, grant: Grant) -> bool:
        """Whether nothing has been heard against a grant since it was given."""
        return self._known.get(token) is grant

    def forget(self, device: str, token_id: str | None = None) -> None:
        """Ask the database anew about one token of a device, or about all of them."""
        self._known.forget(device, token_id)

    async def _ask(self, token: str) -> Grant:
        claims = self._signer.read(token, time.time())
        if claims is None:
            _refuse_token()
        while True:
            changes = self._known.changes
            device = await self._gateway.work(self._gateway.store.by_token, claims.id)
            if self._known.changes != changes:
                continue  # something was revoked meanwhile, perhaps this: its answer may be from before
            if device is None or device.id != claims.device:
                _refuse_token()
            grant = Grant(claims, device)
            self._known.remember(token, grant, time.time())
            return grant


def _allowed(grant: Grant, scope: str) -> Grant:
    if scope not in grant.claims.scopes:
        refuse("Authorization", "the token may not do this", " ".join(sorted(grant.claims.scopes)), scope, 403)
    return grant


def _refuse_token() -> NoReturn:
    problem = FieldError(field="Authorization", problem="no valid token", allowed="Bearer TOKEN, from enrolment")
    raise RequestError(401, problem, headers={"WWW-Authenticate": "Bearer"})
