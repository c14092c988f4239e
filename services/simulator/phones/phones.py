"""Emulated phones at the real gateway: they enrol, post what they measured, and never give up.

Everything a phone could not send waits and is sent later, oldest first, with the same sequence number; a refused
connection, a timeout, 429, 503 or an answer that is none is tried again after a growing pause, and a phone that the
gateway no longer knows enrols anew. The protocol is that of ``docs/phone-app.md``, written by hand as an app's author
would.
"""

from __future__ import annotations

import asyncio
import contextlib
import ssl
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import httpx
import msgspec
import numpy as np
import structlog
from prometheus_client import Counter, Gauge

from services.simulator.phones.phone import EmulatedPhone
from services.simulator.phones.phone_batch import PhoneBatch
from services.simulator.phones.posting import body_of

__all__ = ["Phones"]

log = structlog.get_logger(__name__)

BATCHES = Counter("atrium_simulator_batches_total", "Batches of emulated phones by what became of them", ["result"])
WAITING = Gauge("atrium_simulator_batches_waiting", "Batches that could not be sent yet")

_KEPT = 600  # batches a phone keeps while it cannot send
_LONGEST_PAUSE = 10.0
_LONGEST_ASKED = 600.0
"""Seconds that a phone waits at most, whatever ``Retry-After`` says."""
_TIMEOUT = 5.0
_MISTAKE = "emulated phones have ended by a mistake of the simulator: "


class _Enrolled(msgspec.Struct):
    """What a gateway answers to an enrolment."""

    device: Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.\-]{0,63}\Z")]
    token: Annotated[str, msgspec.Meta(pattern=r"^[!-~]{1,1000}\Z")]


class _Taken(msgspec.Struct):
    """What a gateway answers to a batch."""

    replied: float


@dataclass(slots=True)
class _Line:
    """One phone's line to the gateway."""

    phone: EmulatedPhone
    device: str | None = None
    token: str = ""
    shift: int | None = 0
    """Added to a batch's own number; None until the first one of a new device, which is number 0 to the gateway."""
    highest: int = -1
    waiting: deque[PhoneBatch] = field(default_factory=deque)
    reply: tuple[float, float] | None = None
    """When the gateway made its last reply, by its clock, and when the phone has it, true seconds of this pass."""
    failures: int = 0
    not_before: float = 0.0
    woken: asyncio.Event = field(default_factory=asyncio.Event)


class Phones:
    """A thread in which all phones live.

    Args:
        phones: the phones.
        gateway_url: base URL of the gateway.
        enrolment_key: with which they enrol.
        seed: of their pauses.
        report: called with a reason in plain words when the gateway does not answer, and with None when it does again.
    """

    def __init__(
        self,
        phones: Sequence[EmulatedPhone],
        gateway_url: str,
        enrolment_key: str,
        seed: int = 0,
        report: Callable[[str | None], None] = lambda reason: None,
    ) -> None:
        self._lines = {phone.person: _Line(phone) for phone in phones}
        self._url = gateway_url.rstrip("/")
        self._key = enrolment_key
        self._rng = np.random.default_rng(seed)
        self._report = report
        self._epoch = 0.0
        self._loop = asyncio.new_event_loop()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run_loop, name="phones", daemon=True)

    @property
    def devices(self) -> dict[str, str]:
        """Device ids by person, of the phones that have enrolled."""
        return {person: line.device for person, line in self._lines.items() if line.device is not None}

    def start(self) -> None:
        """Let the phones enrol; they send what is given to ``post``."""
        self._thread.start()

    def follow(self, epoch: float) -> None:
        """Begin a new pass of the world, whose second zero is the true time ``epoch``; what waits is forgotten."""
        self._tell(self._begin, epoch)

    def post(self, batch: PhoneBatch) -> None:
        """Send a batch of this pass that arrives now: at the true time ``epoch + batch.arrival``. Any thread may call.

        KeyError: nobody of that name has a phone.
        """
        self._tell(self._take, self._lines[batch.person], batch)

    def stop(self) -> None:
        """End the thread; what waits is not sent any more."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(timeout=2.0)
        elif not self._loop.is_closed():
            self._loop.close()

    def _tell(self, what: Callable[..., None], *arguments: object) -> None:
        """Call in the phones' thread, in order; they may not have started yet, or have ended: then nothing happens."""
        if not self._stopping.is_set():
            with contextlib.suppress(RuntimeError):  # the loop is closed; its thread has told why
                self._loop.call_soon_threadsafe(what, *arguments)

    def _run_loop(self) -> None:
        try:
            self._loop.run_until_complete(self._live())
        except Exception as error:  # a bug: the world goes on without phones, and says so
            log.exception("phones ended")
            self._report(f"{_MISTAKE}{type(error).__name__}: {error}")
        finally:
            self._loop.close()

    async def _live(self) -> None:
        trusted = ssl.create_default_context()
        async with contextlib.AsyncExitStack() as clients:
            tasks = []
            for line in self._lines.values():
                # Each phone has a connection of its own: a pool looks at all it has before every request.
                # Proxies of the environment are for the world outside, not for a gateway in the house.
                client = httpx.AsyncClient(base_url=self._url, timeout=_TIMEOUT, verify=trusted, trust_env=False)
                tasks.append(asyncio.create_task(self._run(line, await clients.enter_async_context(client))))
            try:
                while not self._stopping.is_set():
                    for task in tasks:
                        if task.done():
                            task.result()  # a bug must not end in silence
                    WAITING.set(sum(len(line.waiting) for line in self._lines.values()))
                    await asyncio.sleep(0.1)
            finally:
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)

    def _begin(self, epoch: float) -> None:
        self._epoch = epoch
        for line in self._lines.values():
            line.waiting.clear()
            line.reply = None
            if line.shift is not None:
                line.shift = line.highest + 1  # to the gateway it is still the same phone

    def _take(self, line: _Line, batch: PhoneBatch) -> None:
        if len(line.waiting) >= _KEPT:
            line.waiting.popleft()
            BATCHES.labels("given up").inc()
        line.waiting.append(batch)
        line.woken.set()

    async def _run(self, line: _Line, client: httpx.AsyncClient) -> None:
        while True:
            pause = line.not_before - time.monotonic()
            if pause > 0.0:
                await asyncio.sleep(pause)
            elif line.device is None or line.waiting:
                await self._send_all(line, client)
            else:
                line.woken.clear()
                await line.woken.wait()

    async def _send_all(self, line: _Line, client: httpx.AsyncClient) -> None:
        try:
            if line.device is None:
                await self._enrol(line, client)
            while line.waiting and line.device is not None:
                if not await self._post(line, client):
                    return
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            self._pause(line, None, f"no answer from {self._url}: {type(error).__name__}")
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            BATCHES.labels("to be repeated").inc(line.device is not None)
            self._pause(line, None, f"no proper answer from {self._url}: {str(error)[:200]}")
        else:
            if line.device is not None:
                line.failures = 0
                if not any(other.failures for other in self._lines.values()):
                    self._report(None)

    async def _enrol(self, line: _Line, client: httpx.AsyncClient) -> None:
        body = {
            "enrolment_key": self._key,
            "consent": True,
            "name": f"emulated phone of {line.phone.person}",
            "platform": "simulator",
            "carrying": line.phone.fleet.enrolled_as,
        }
        answer = await client.post("/v1/devices", json=body)
        if answer.status_code != 201:
            self._pause(line, answer, f"{self._url} refused an enrolment: {answer.status_code} {answer.text[:200]}")
            return
        enrolled = msgspec.json.decode(answer.content, type=_Enrolled)
        line.device, line.token = enrolled.device, enrolled.token
        line.shift, line.highest = None, -1
        log.info("phone enrolled", person=line.phone.person, device=line.device)

    async def _post(self, line: _Line, client: httpx.AsyncClient) -> bool:
        """Send the oldest batch; whether to go on with the next."""
        batch = line.waiting[0]
        if line.shift is None:
            line.shift = -min(waiting.seq for waiting in line.waiting)
        number = batch.seq + line.shift
        if number < 0:  # the copy of a batch from before this phone enrolled anew
            line.waiting.popleft()
            return True
        line.highest = max(line.highest, number)
        # It comes here when it arrives: it was sent a journey ago, or later by as long as it waited here.
        sent = batch.sent + max(0.0, self._now() - batch.arrival)
        body = body_of(batch, self._epoch)
        body.update(seq=number, sent=self._shown(batch, sent))
        if line.reply is not None and line.reply[1] <= sent:
            body["echo"] = {"replied": line.reply[0], "arrived": self._shown(batch, line.reply[1])}
        headers = {"Authorization": f"Bearer {line.token}", "Content-Type": "application/json"}
        answer = await client.post(
            f"/v1/devices/{line.device}/batches", content=msgspec.json.encode(body), headers=headers
        )
        status = answer.status_code
        if status in (200, 202):
            taken = msgspec.json.decode(answer.content, type=_Taken)
            # Replies take as long as what they reply to.
            line.reply = taken.replied, self._now() + batch.arrival - batch.sent
        elif status in (401, 403, 404):
            # The gateway has forgotten this phone: it may have lost its database. Enrol again, keep what waits.
            log.warning("phone no longer known", person=line.phone.person, device=line.device, status=status)
            line.device, line.reply = None, None
            self._pause(line, answer, f"{self._url} no longer knows a phone: {status}")
            return False
        elif status in (408, 429) or not 400 <= status < 500:
            BATCHES.labels("to be repeated").inc()
            proper = status in (408, 429) or status >= 500
            self._pause(line, answer, f"{self._url} {'is busy' if proper else 'gives no proper answer'}: {status}")
            return False
        else:
            # This very batch is not wanted, and would not be tomorrow.
            log.warning("batch refused", person=line.phone.person, status=status, answer=answer.text[:300])
            BATCHES.labels("refused").inc()
            self._done(line, batch)
            return True
        BATCHES.labels("accepted").inc()
        self._done(line, batch)
        return True

    @staticmethod
    def _done(line: _Line, batch: PhoneBatch) -> None:
        """Forget a batch, unless a new pass began meanwhile and has forgotten all."""
        if line.waiting and line.waiting[0] is batch:
            line.waiting.popleft()

    def _pause(self, line: _Line, answer: httpx.Response | None, reason: str) -> None:
        asked = answer.headers.get("Retry-After", "") if answer is not None else ""
        growing = min(_LONGEST_PAUSE, 0.5 * 2.0 ** min(line.failures, 10)) * float(self._rng.uniform(0.7, 1.0))
        line.failures += 1
        line.not_before = time.monotonic() + (min(float(asked), _LONGEST_ASKED) if asked.isdecimal() else growing)
        if line.failures > 1:  # once is nothing: at start the gateway may be a second behind
            self._report(reason)

    def _now(self) -> float:
        """Return true seconds of this pass."""
        return time.time() - self._epoch

    def _shown(self, batch: PhoneBatch, t: float) -> float:
        """Return what the clock of a batch's phone shows at ``t`` seconds of this pass."""
        return self._epoch + float(batch.clock.read(np.array([t]))[0])
