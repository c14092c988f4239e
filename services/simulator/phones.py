"""Emulated phones at the real gateway: they enrol, post a batch a second, and never give up.

Everything a phone could not send waits and is sent later, oldest first, with the same sequence number; a refused
connection, a timeout, 429 or 503 is tried again after a growing pause, and a phone that the gateway no longer knows
enrols anew. The protocol is that of ``docs/phone-app.md``, written by hand as an app's author would.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import httpx
import numpy as np
import structlog
from prometheus_client import Counter, Gauge

from services.simulator.people import People
from services.simulator.phone import RATE, EmulatedPhone

__all__ = ["Phones"]

log = structlog.get_logger(__name__)

BATCHES = Counter("atrium_simulator_batches_total", "Batches of emulated phones by what became of them", ["result"])
WAITING = Gauge("atrium_simulator_batches_waiting", "Batches that could not be sent yet")

_PERIOD = 1.0  # seconds a batch
_KEPT = 600  # batches a phone keeps while it cannot send
_LONGEST_PAUSE = 10.0
_TIMEOUT = 5.0


@dataclass(frozen=True, slots=True)
class _Pass:
    """One run of the world: whose whereabouts, and the true time of its second zero."""

    people: People
    epoch: float


@dataclass(slots=True)
class _Line:
    """One phone's line to the gateway."""

    phone: EmulatedPhone
    device: str | None = None
    token: str = ""
    seq: int = 0
    waiting: deque[dict[str, Any]] = field(default_factory=deque)
    echo: dict[str, float] | None = None
    failures: int = 0
    not_before: float = 0.0
    measured: float = 0.0


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
        self._lines = [_Line(phone) for phone in phones]
        self._url = gateway_url.rstrip("/")
        self._key = enrolment_key
        self._rng = np.random.default_rng(seed)
        self._report = report
        self._pass: _Pass | None = None
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._live()), name="phones", daemon=True)

    @property
    def devices(self) -> dict[str, str]:
        """Device ids by person, of the phones that have enrolled."""
        return {line.phone.person: line.device for line in self._lines if line.device is not None}

    def start(self) -> None:
        """Let the phones enrol; they measure once ``follow`` has been called."""
        self._thread.start()

    def follow(self, people: People, epoch: float) -> None:
        """Measure from now on along ``people``, whose second zero is the true time ``epoch``."""
        self._pass = _Pass(people, epoch)

    def stop(self) -> None:
        """End the thread; what waits is not sent any more."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(timeout=2.0)

    async def _live(self) -> None:
        limits = httpx.Limits(max_connections=max(10, len(self._lines)))
        # Proxies of the environment are for the world outside, not for a gateway in the house.
        async with httpx.AsyncClient(base_url=self._url, timeout=_TIMEOUT, limits=limits, trust_env=False) as client:
            tasks = [asyncio.create_task(self._run(line, client)) for line in self._lines]
            while not self._stopping.is_set():
                for task in tasks:
                    if task.done():
                        task.result()  # a bug must not end in silence
                WAITING.set(sum(len(line.waiting) for line in self._lines))
                await asyncio.sleep(0.1)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _run(self, line: _Line, client: httpx.AsyncClient) -> None:
        current: _Pass | None = None
        # Phones are switched on at any moment: their seconds begin at different times.
        phase = float(self._rng.uniform(0.0, _PERIOD))
        while True:
            chosen = self._pass
            if chosen is not None:
                if chosen is not current:
                    current = chosen
                    line.waiting.clear()
                    line.measured = max(0.0, float(np.floor(time.time() - chosen.epoch)))
                self._measure(line, current)
            if time.monotonic() >= line.not_before:
                await self._send_all(line, client)
            await asyncio.sleep(_PERIOD - (time.time() - phase) % _PERIOD)

    def _measure(self, line: _Line, current: _Pass) -> None:
        """Queue a batch for every second that has passed."""
        now = float(np.floor((time.time() - current.epoch) * RATE) / RATE)
        while now - line.measured > 0.2 * _PERIOD:
            # A phone that was held up has more to tell, but no batch is much longer than a second.
            end = now if now - line.measured < 1.5 * _PERIOD else line.measured + _PERIOD
            batch = line.phone.measure(current.people, line.measured, end, current.epoch)
            line.measured = end
            if batch is None:
                continue
            batch["seq"] = line.seq
            line.seq += 1
            if len(line.waiting) >= _KEPT:
                line.waiting.popleft()
                BATCHES.labels("given up").inc()
            line.waiting.append(batch)

    async def _send_all(self, line: _Line, client: httpx.AsyncClient) -> None:
        try:
            if line.device is None:
                await self._enrol(line, client)
            while line.waiting and line.device is not None:
                if not await self._post(line, client):
                    return
        except httpx.TransportError as error:
            self._pause(line, None, f"no answer from {self._url}: {type(error).__name__}")
        else:
            if line.device is not None:
                line.failures = 0
                if not any(other.failures for other in self._lines):
                    self._report(None)

    async def _enrol(self, line: _Line, client: httpx.AsyncClient) -> None:
        body = {
            "enrolment_key": self._key,
            "consent": True,
            "name": f"emulated phone of {line.phone.person}",
            "platform": "simulator",
            "carrying": line.phone.carrying,
        }
        answer = await client.post("/v1/devices", json=body)
        if answer.status_code != 201:
            self._pause(line, answer, f"{self._url} refused an enrolment: {answer.status_code} {answer.text[:200]}")
            return
        enrolled = answer.json()
        line.device, line.token = enrolled["device"], enrolled["token"]
        line.seq = 0
        for batch in line.waiting:
            batch["seq"] = line.seq
            line.seq += 1
        log.info("phone enrolled", person=line.phone.person, device=line.device)

    async def _post(self, line: _Line, client: httpx.AsyncClient) -> bool:
        """Send the oldest batch; whether to go on with the next."""
        batch = line.waiting[0]
        body = {**batch, "sent": self._clock(line)}
        if line.echo is not None:
            body["echo"] = line.echo
        answer = await client.post(
            f"/v1/devices/{line.device}/batches", json=body, headers={"Authorization": f"Bearer {line.token}"}
        )
        status = answer.status_code
        if status == 200:
            line.echo = {"replied": answer.json()["replied"], "arrived": self._clock(line)}
        elif status in (401, 403, 404):
            # The gateway has forgotten this phone: it may have lost its database. Enrol again, keep what waits.
            log.warning("phone no longer known", person=line.phone.person, device=line.device, status=status)
            line.device, line.echo = None, None
            self._pause(line, answer, f"{self._url} no longer knows a phone: {status}")
            return False
        elif status == 429 or status >= 500:
            BATCHES.labels("to be repeated").inc()
            self._pause(line, answer, f"{self._url} is busy: {status}")
            return False
        else:
            # This very batch is not wanted, and would not be tomorrow.
            log.warning("batch refused", person=line.phone.person, status=status, answer=answer.text[:300])
            BATCHES.labels("refused").inc()
            line.waiting.popleft()
            return True
        BATCHES.labels("accepted").inc()
        line.waiting.popleft()
        return True

    def _pause(self, line: _Line, answer: httpx.Response | None, reason: str) -> None:
        asked = answer.headers.get("Retry-After", "") if answer is not None else ""
        growing = min(_LONGEST_PAUSE, 0.5 * 2.0 ** min(line.failures, 10)) * float(self._rng.uniform(0.7, 1.0))
        line.failures += 1
        line.not_before = time.monotonic() + (float(asked) if asked.isdigit() else growing)
        if line.failures > 1:  # once is nothing: at start the gateway may be a second behind
            self._report(reason)

    def _clock(self, line: _Line) -> float:
        return float(line.phone.clock.read(np.array([time.time()]))[0])
