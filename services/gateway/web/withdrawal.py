"""The end of a consent, whoever asked for it: the phone itself, or staff for a visitor who stands before them."""

from __future__ import annotations

import asyncio
import time

import msgspec
import structlog
from prometheus_client import Counter
from sqlalchemy.exc import SQLAlchemyError

from services.gateway.web.gateway import Gateway
from services.gateway.web.stream import Streams
from services.gateway.web.who_asks import WhoAsks
from shared.bus import Question
from shared.keys import is_identifier
from shared.withdrawal import WithdrawalAnswer, WithdrawalOrder

__all__ = ["Withdrawal"]

WITHDRAWN = Counter("atrium_gateway_withdrawn_total", "Consents withdrawn")

log = structlog.get_logger(__name__)


class Withdrawal:
    """Carries withdrawals out; its coroutines run in the event loop of HTTP."""

    def __init__(self, gateway: Gateway, who_asks: WhoAsks, streams: Streams) -> None:
        self._gateway = gateway
        self._who_asks = who_asks
        self._streams = streams
        self._orders: set[asyncio.Task[None]] = set()

    async def carry_out(self, device: str) -> None:
        """Forget a device: all its tokens die at once, and everybody is told to forget it.

        Raises:
            SQLAlchemyError: the database is away; nothing was done.
        """
        gateway = self._gateway
        await gateway.work(gateway.store.withdraw, device, time.time())
        self._who_asks.forget(device)
        gateway.numbering.forget(device)
        gateway.positions.forget(device)
        gateway.alerts.forget(device)
        await self._streams.close(device, "the consent was withdrawn")
        await gateway.work(gateway.receivers.forget, device)
        try:
            await gateway.work(gateway.phones.forget, device)
        except SQLAlchemyError:  # the consent is withdrawn all the same: what waits is erased with the telling
            log.warning("what waits of a withdrawn device is erased later", device=device)
        await gateway.work(gateway.erasures.tell)
        WITHDRAWN.inc()
        log.info("consent withdrawn", device=device)

    def take(self, question: Question) -> None:
        """Begin to carry out an order of staff; what came of it is its answer."""
        task = asyncio.ensure_future(self._obey(question))
        self._orders.add(task)
        task.add_done_callback(self._orders.discard)

    async def _obey(self, question: Question) -> None:
        try:
            answer = await self._answer(question.payload)
        except SQLAlchemyError:
            answer = WithdrawalAnswer(outcome="away", words="the gateway's database is away; nothing was changed")
        await self._gateway.work(question.answer, msgspec.json.encode(answer))

    async def _answer(self, payload: bytes) -> WithdrawalAnswer:
        try:
            order = msgspec.json.decode(payload, type=WithdrawalOrder)
        except msgspec.MsgspecError as error:
            return WithdrawalAnswer(outcome="not-understood", words=f"the order: {error}")
        store = self._gateway.store
        try:
            if not is_identifier(order.device):
                raise KeyError(order.device)
            if await self._gateway.work(store.withdrawn, order.device) is None:
                await self.carry_out(order.device)
                log.warning("consent withdrawn by staff", device=order.device, by=order.by[:64])
            ended = await self._gateway.work(store.withdrawn, order.device)
        except KeyError:
            return WithdrawalAnswer(outcome="unknown", words="no such device was ever enrolled")
        return WithdrawalAnswer(outcome="withdrawn", t=ended or time.time())
