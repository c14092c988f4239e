"""One connection to the API for all browsers: follows its stream, keeps the present, tells each what it may see.

It is the dashboard's own key that follows; whoever signed in by name is told no more than their role may see. The key
stays in this process. When the API goes away the relay says so in plain words and comes back by itself.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable

import httpx
import msgspec
import structlog
from prometheus_client import Counter, Gauge

from services.dashboard.event_stream import EventReader, StreamError
from services.dashboard.live_state import LiveState, Post, scope_of
from services.dashboard.mailbox import Mailbox
from services.dashboard.sessions import Visitor

__all__ = ["BUSY", "Relay"]

log = structlog.get_logger(__name__)

BROWSERS = Gauge("atrium_dashboard_browsers", "Browsers that watch now")
EVENTS = Counter("atrium_dashboard_events_total", "Events received from the API", ["event"])
RECONNECTS = Counter("atrium_dashboard_api_connections_total", "Connections made to the API's stream")
UNREADABLE = Counter("atrium_dashboard_unreadable_total", "Events and answers of the API that were not understood")
OVERTAKEN = Counter("atrium_dashboard_dropped_total", "Posts a slow browser never got, apart from replaced ones")

EVENT_NAMES = ("tracks", "alert", "acknowledged", "camera")
BUSY = 200
"""Browsers served at once; more are asked to come back later."""
KEEP_ALIVE = b": still here\n\n"
KEEP_ALIVE_EVERY = 5.0
POLL_EVERY = 1.0
RETRY_FIRST, RETRY_LAST = 0.5, 5.0
SILENCE = 30.0
"""Seconds without a byte after which a connection counts as dead; the API sends keep-alives more often."""


class _ApiError(RuntimeError):
    """The API answered, but not with what was asked for: the text says it in plain words."""


class Relay:
    """The dashboard's client of the API. Belongs to one event loop, in which ``run`` is a task.

    Args:
        api_url: without a slash at the end.
        api_key: sent as a bearer token, never shown.
        told: called with None when all is well, else with the reason in plain words.
    """

    def __init__(self, api_url: str, api_key: str, told: Callable[[str | None], None]) -> None:
        self._url = api_url
        self._headers = {"Authorization": f"Bearer {api_key}"}
        self._told = told
        self._state = LiveState()
        self._browsers: dict[Mailbox, Visitor] = {}
        self._site_tag = ""
        """Of the site that the browsers were told."""
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stopped = False

    async def run(self) -> None:
        """Follow the API until cancelled."""
        self._loop = asyncio.get_running_loop()
        delay = RETRY_FIRST
        # The address comes from the operator: proxies of the environment are not for it.
        timeout = httpx.Timeout(10.0, read=SILENCE)
        async with httpx.AsyncClient(headers=self._headers, timeout=timeout, trust_env=False) as client:
            while True:
                started = time.monotonic()
                reason = await self._follow(client)
                if time.monotonic() - started > 10.0:
                    delay = RETRY_FIRST
                self._told(reason)
                self._tell(self._state.connection(False, reason, time.time()))
                await asyncio.sleep(delay)
                delay = min(2.0 * delay, RETRY_LAST)

    async def watch(self, visitor: Visitor) -> AsyncIterator[bytes]:
        """Yield the stream for one browser, from the present on, until it leaves, signs out, or the dashboard stops."""
        mailbox = Mailbox()
        self._browsers[mailbox] = visitor
        BROWSERS.set(len(self._browsers))
        try:
            yield b"retry: 1000\n\n" + self._state.everything(visitor.may)
            while True:
                chunk = await mailbox.take(KEEP_ALIVE_EVERY) or KEEP_ALIVE
                if mailbox.closed or self._stopped or not visitor.here:
                    return
                yield chunk
        finally:
            self._browsers.pop(mailbox, None)
            BROWSERS.set(len(self._browsers))
            OVERTAKEN.inc(mailbox.dropped)

    @property
    def busy(self) -> bool:
        """Whether no further browser should be served now."""
        return len(self._browsers) >= BUSY

    def stop(self) -> None:
        """End every browser's stream, so that the server can close; may be called from any thread."""
        self._stopped = True
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._close_all)

    def _close_all(self) -> None:
        for mailbox in self._browsers:
            mailbox.close()

    async def _follow(self, client: httpx.AsyncClient) -> str:
        """Follow the stream as long as it lasts and return, in plain words, why it ended."""
        try:
            async with client.stream("GET", f"{self._url}/v1/stream") as response:
                _check(response)
                # The stream is open before the present is asked for: nothing falls between the two.
                for what in ("site", "cameras", "zones", "alerts"):
                    await self._ask(client, what)
                RECONNECTS.inc()
                log.info("following the API", url=self._url)
                self._told(None)
                self._tell(self._state.connection(True, "", time.time()))
                poll = asyncio.create_task(self._poll(client))
                try:
                    await self._read(response)
                finally:
                    poll.cancel()
            return "The API closed the connection; it may be restarting."
        except _ApiError as error:
            return str(error)
        except httpx.TimeoutException:
            return f"The API at {self._url} does not answer."
        except httpx.ConnectError:
            return f"The API at {self._url} cannot be reached; is it running?"
        except httpx.HTTPError as error:
            log.debug("connection lost", error=repr(error))
            return "The connection was lost."
        except (StreamError, msgspec.MsgspecError, KeyError, TypeError) as error:
            UNREADABLE.inc()
            log.warning("the API's answer was not understood", error=str(error))
            return "The API's answer was not understood; do API and dashboard have the same version?"

    async def _read(self, response: httpx.Response) -> None:
        reader = EventReader()
        async for chunk in response.aiter_bytes():
            for event in reader.feed(chunk):
                EVENTS.labels(event.name if event.name in EVENT_NAMES else "other").inc()
                try:
                    self._tell(self._state.event(event))
                except (msgspec.MsgspecError, KeyError, TypeError) as error:
                    UNREADABLE.inc()
                    log.debug("event not understood", name=event.name, error=str(error))

    async def _poll(self, client: httpx.AsyncClient) -> None:
        """Ask again and again for what the stream does not tell: zones, how and where cameras are."""
        while True:
            await asyncio.sleep(POLL_EVERY)
            try:
                await self._ask(client, "zones")
                await self._ask(client, "cameras")
                await self._ask(client, "site")
            except (httpx.HTTPError, _ApiError, msgspec.MsgspecError, KeyError, TypeError) as error:
                # If the API is gone, the stream tells; one missed answer is no news.
                log.debug("no answer", error=str(error))

    async def _ask(self, client: httpx.AsyncClient, what: str) -> None:
        known = {"If-None-Match": self._site_tag} if what == "site" and self._site_tag else {}
        response = await client.get(f"{self._url}/v1/{what}", timeout=10.0, headers=known)
        if known and response.status_code == 304:
            return
        _check(response)
        if what == "site":
            self._site_tag = response.headers.get("ETag", "")
        self._tell(self._state.answer(what, response.content))

    def _tell(self, posts: list[Post]) -> None:
        for topic, chunk in posts:
            scope = scope_of(topic)
            for mailbox, visitor in self._browsers.items():
                if visitor.may(scope):
                    mailbox.post(topic, chunk)


def _check(response: httpx.Response) -> None:
    if response.status_code in (401, 403):
        raise _ApiError("The API refuses the dashboard's key; set ATRIUM_API_KEY to a key it accepts.")
    if response.status_code != 200:
        raise _ApiError(f"The API has a problem of its own (status {response.status_code} for {response.url.path}).")
