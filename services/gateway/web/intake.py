"""May this batch come in now, and what became of it? The one way in for batches, however they arrived."""

from __future__ import annotations

import math

from services.gateway.devices.storage import Registered
from services.gateway.errors import RequestError
from services.gateway.phones.phone import NATIVE
from services.gateway.phones.phone_book import busy
from services.gateway.protocol import Batch, BatchReply, FieldError
from services.gateway.web.gateway import Gateway
from shared.rate_limiter import RateLimiter

__all__ = ["Intake"]

WAITING_BATCHES = 500
"""Batches in work at once; more are answered 503 rather than kept waiting."""


class Intake:
    """Rations batches by device and hands them to the phones; touched by the event loop only."""

    def __init__(self, gateway: Gateway) -> None:
        settings = gateway.settings
        self._gateway = gateway
        self._limiter = RateLimiter(settings.batches_per_second, settings.batch_burst)
        self._waiting = 0

    def admit(self, device: str) -> None:
        """Count one batch of a device before it is read.

        Raises:
            RequestError: 429 where this device posts too fast, 503 where too many batches wait.
        """
        wait = self._limiter.wait(device)
        if wait > 0.0:
            problem = FieldError(field="", problem="this device posts too fast", allowed="fewer and larger batches")
            raise RequestError(429, problem, headers={"Retry-After": str(math.ceil(wait))})
        if self._waiting >= WAITING_BATCHES:
            raise busy("more batches wait than can be taken")
        self._limiter.spend(device)

    async def take(self, owner: Registered, batch: bytes | Batch, received: float, source: str = NATIVE) -> BatchReply:
        """Return the reply once everything in the batch is on the bus.

        Args:
            owner: whose it is.
            batch: as JSON or read already.
            received: server clock when it arrived.
            source: who numbered it: the app itself or an adapter.

        Raises:
            RequestError: it is refused, and nothing of it used.
        """
        if self._waiting >= WAITING_BATCHES:
            raise busy("more batches wait than can be taken")
        self._waiting += 1
        try:
            return await self._gateway.phones.submit_soon(owner, batch, received, source)
        finally:
            self._waiting -= 1
