"""Sends what waits for webhooks: signed, in parallel, each with a deadline, again with growing pauses, then given up.

A thread with an event loop of its own, so that no receiver holds up the API. What is to be sent is read from the
database and struck off when a receiver took it: a message may come twice (its id is the same), and none is lost.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import random
import ssl
import threading
import time
from collections import Counter as Tally
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import httpcore
import msgspec
import structlog
from prometheus_client import Counter, Gauge, Histogram
from sqlalchemy.exc import SQLAlchemyError

from services.api.alerts.receiver_address import CheckedNetwork, Network, Resolve
from services.api.alerts.signature import signed_headers
from services.api.alerts.webhook_replies import WebhookMessage
from services.api.alerts.webhook_store import Due, WebhookStore

__all__ = ["Patience", "WebhookSender", "pause_after"]

log = structlog.get_logger(__name__)

ATTEMPTS = Counter("atrium_webhook_attempts_total", "Messages to webhooks", ["outcome"])
SECONDS = Histogram("atrium_webhook_seconds", "How long receivers took to take a message")
WAITING = Gauge("atrium_webhook_waiting", "Messages that wait to be taken")

EACH = 4
"""Messages under way to one webhook."""
LOOK_EVERY = 1.0
FORGET_EVERY = 600.0
_FAILURES = (
    httpcore.NetworkError,
    httpcore.TimeoutException,
    httpcore.ProtocolError,
    httpcore.UnsupportedProtocol,
    OSError,
    ssl.SSLError,
    ValueError,
)


@dataclass(frozen=True, slots=True)
class Patience:
    """How long a receiver may take, s; how often and with which pauses, s, it is tried."""

    timeout: float
    attempts: int
    first_pause: float
    longest_pause: float


def pause_after(attempts: int, patience: Patience, chance: float) -> float:
    """Return how long to wait after so many attempts, s: doubled each time, from half to one and a half by chance.

    Args:
        attempts: made so far, at least 1.
        patience: the first and the longest pause.
        chance: from 0 to 1, so that what failed together does not come back together.
    """
    doubled = patience.first_pause * 2.0 ** min(attempts - 1, 60)
    return min(patience.longest_pause, doubled) * (0.5 + chance)


class WebhookSender:
    """Sends until asked to stop.

    Args:
        store: what is to be sent.
        site: whose alerts they are.
        patience: with receivers.
        allowed: networks that may be private.
        resolve: a host's name and port → its addresses.
    """

    def __init__(
        self,
        store: WebhookStore,
        site: str,
        patience: Patience,
        allowed: Sequence[Network],
        resolve: Resolve,
    ) -> None:
        self._store = store
        self._site = site
        self._patience = patience
        self._network = CheckedNetwork(allowed, resolve)
        self._under_way: dict[int, str] = {}
        """By delivery, the webhook it goes to."""
        self._wake: Callable[[], object] = lambda: None

    def wake(self) -> None:
        """There may be something to send; from any thread."""
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._wake()

    def run(self, stopping: threading.Event) -> None:
        """Send until asked to stop; what is under way then is sent again at the next start."""
        asyncio.run(self._run(stopping))

    async def _run(self, stopping: threading.Event) -> None:
        loop, changed = asyncio.get_running_loop(), asyncio.Event()
        self._wake = lambda: loop.call_soon_threadsafe(changed.set)
        sending: set[asyncio.Task[None]] = set()
        forget_at = 0.0
        # No connection is kept: each is checked anew. Redirects are not followed, proxies of the environment not used.
        async with httpcore.AsyncConnectionPool(
            max_connections=None, max_keepalive_connections=0, network_backend=self._network
        ) as pool:
            while not stopping.is_set():
                changed.clear()
                try:
                    room = {hook: EACH - number for hook, number in Tally(self._under_way.values()).items()}
                    under_way = set(self._under_way)
                    for due in await asyncio.to_thread(self._store.due, time.time(), room, EACH, under_way):
                        self._under_way[due.delivery] = due.webhook
                        task = asyncio.create_task(self._deliver(pool, due, changed))
                        sending.add(task)
                        task.add_done_callback(sending.discard)
                    WAITING.set(await asyncio.to_thread(self._store.waiting))
                    if loop.time() >= forget_at:
                        await asyncio.to_thread(self._store.forget, time.time())
                        forget_at = loop.time() + FORGET_EVERY
                except SQLAlchemyError as error:
                    log.warning("webhooks wait: the database is away", reason=type(error).__name__)
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(LOOK_EVERY):
                        await changed.wait()
            for task in sending:
                task.cancel()
            await asyncio.gather(*sending, return_exceptions=True)

    async def _deliver(self, pool: httpcore.AsyncConnectionPool, due: Due, changed: asyncio.Event) -> None:
        try:
            reason = await self._send(pool, due)
            now = time.time()
            if reason is None:
                ATTEMPTS.labels("delivered").inc()
                await asyncio.to_thread(self._store.delivered, due, now)
            else:
                attempts = due.attempts + 1
                dead = attempts >= self._patience.attempts
                ATTEMPTS.labels("dead" if dead else "failed").inc()
                again = None if dead else now + pause_after(attempts, self._patience, random.random())
                log.info("webhook not taken", webhook=due.webhook, reason=reason, attempts=attempts, given_up=dead)
                await asyncio.to_thread(self._store.failed, due, now, reason, again)
        except SQLAlchemyError as error:
            # It stands in the database as it did: it is sent again, which receivers know by its id.
            log.warning("what became of a webhook is not written down", reason=type(error).__name__)
        finally:
            del self._under_way[due.delivery]
            changed.set()

    async def _send(self, pool: httpcore.AsyncConnectionPool, due: Due) -> str | None:
        """Send one message; return why it was not taken, None if it was."""
        message = "msg_" + hashlib.sha256(f"{due.webhook}/{due.alert.id}".encode()).hexdigest()[:32]
        body = msgspec.json.encode(WebhookMessage(id=message, site=self._site, alert=due.alert))
        headers = {
            "Content-Type": "application/json",
            "User-Agent": "atrium",
            **signed_headers(due.secret, message, int(time.time()), body),
        }
        began = time.monotonic()
        try:
            async with (
                asyncio.timeout(self._patience.timeout),
                pool.stream("POST", due.url, headers=list(headers.items()), content=body) as response,
            ):
                status = response.status
        except TimeoutError:
            return f"no answer within {self._patience.timeout:g} s"
        except _FAILURES as error:
            return str(error) or type(error).__name__
        SECONDS.observe(time.monotonic() - began)
        if 200 <= status < 300:
            return None
        return f"answered {status}" + (", and redirects are not followed" if 300 <= status < 400 else "")
