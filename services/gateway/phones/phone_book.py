"""All phones of this gateway: one state each, their publishers, and the promise that what is acknowledged is sent."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict, deque
from dataclasses import dataclass, field
from typing import NoReturn

import structlog
from prometheus_client import Counter, Gauge

from services.gateway.devices.storage import Registered
from services.gateway.errors import RequestError, read_json, refuse
from services.gateway.phones.batch_check import Limits
from services.gateway.phones.phone import Phone
from services.gateway.protocol import Batch, BatchReply, FieldError
from shared.bus import Bus, Publisher
from shared.keys import Keys
from shared.messages import Erasure, MotionBatch, RadioScan
from shared.site import Site

__all__ = ["PhoneBook", "busy"]

BATCHES = Counter("atrium_gateway_batches_total", "Batches of phones", ["result"])
USED = Counter("atrium_gateway_accepted_total", "What was used of batches", ["kind"])
IGNORED = Counter("atrium_gateway_ignored_total", "What was not used of batches", ["reason"])
PHONES = Gauge("atrium_gateway_phones", "Phones that posted lately")
OUTBOX = 10_000
"""Messages a phone may have waiting for the bus before its batches are refused."""
FORGOTTEN_KEPT = 100_000
"""Forgotten devices remembered: far more than can have a batch on its way at once."""

log = structlog.get_logger(__name__)


def busy(problem: str) -> RequestError:
    """Return the refusal of a request that may be tried again in a second."""
    return RequestError(503, FieldError(field="", problem=problem), headers={"Retry-After": "1"})


@dataclass(slots=True)
class _Entry:
    phone: Phone
    lock: threading.Lock = field(default_factory=threading.Lock)
    last_heard: float = 0.0
    radio: Publisher[RadioScan] | None = None
    motion: Publisher[MotionBatch] | None = None
    forgotten: bool = False

    def hush(self) -> None:
        """Withdraw the publishers."""
        for publisher in (self.radio, self.motion):
            if publisher is not None:
                publisher.close()
        self.radio = self.motion = None


class PhoneBook:
    """Takes batches from any thread; phones do not wait for each other."""

    def __init__(self, site: Site, bus: Bus, limits: Limits, idle: float) -> None:
        self._bus = bus
        self._keys = Keys(site.site)
        self._north = site.north_radians
        self._limits = limits
        self._idle = idle
        self._access_points = {address.lower(): point.id for point in site.access_points for address in point.addresses}
        self._entries: dict[str, _Entry] = {}
        self._forgotten: OrderedDict[str, None] = OrderedDict()
        self._untold: deque[str] = deque()
        self._lock = threading.Lock()

    def post(self, device: Registered, body: bytes, received: float) -> BatchReply:
        """Take one batch and put what it holds on the bus.

        Raises:
            RequestError: 4xx for a bad batch or a forgotten device, nothing of it used; 503 where the bus is away: send
                it again, what was used of it is kept and will be published once.
        """
        try:
            batch = read_json(body, Batch)
            entry = self._entry(device)
            with entry.lock:
                reply = self._take(entry, batch, received)
        except RequestError as error:
            BATCHES.labels("waiting" if error.status == 503 else "refused").inc()
            raise
        BATCHES.labels("duplicate" if reply.duplicate else "accepted").inc()
        return reply

    def forget(self, device: str) -> None:
        """Forget a device whose consent was withdrawn, for good; what it sent and is not yet on the bus is dropped."""
        with self._lock:
            self._forgotten[device] = None
            if len(self._forgotten) > FORGOTTEN_KEPT:
                self._forgotten.popitem(last=False)
            entry = self._entries.pop(device, None)
            PHONES.set(len(self._entries))
        if entry is not None:
            with entry.lock:
                entry.forgotten = True
                entry.phone.outbox.clear()
                entry.hush()
        with self._lock:
            self._untold.append(device)
        self._tell_erasures()

    def _tell_erasures(self) -> None:
        """Tell everybody whom to forget; what cannot be told while the bus is away is told by ``rest`` later."""
        while self._bus.connected:
            with self._lock:
                if not self._untold:
                    return
                device = self._untold.popleft()
            publisher = self._bus.publisher(self._keys.erasure(device), Erasure)
            publisher.publish(Erasure(t=time.time(), device=device))
            publisher.close()

    def has_forgotten(self, device: str) -> bool:
        """Whether this device's consent was withdrawn here."""
        with self._lock:
            return device in self._forgotten

    def rest(self, now: float) -> None:
        """Let idle phones cost nothing; ``now`` is monotonic. After twelve times as long they are forgotten whole."""
        self._tell_erasures()
        with self._lock:
            entries = list(self._entries.items())
        for device, entry in entries:
            if now - entry.last_heard <= self._idle or not entry.lock.acquire(blocking=False):
                continue
            try:
                entry.hush()
                entry.phone.rest()
                with self._lock:  # last_heard changes under this lock: nobody is on the way to this entry
                    if now - entry.last_heard > 12 * self._idle and not entry.phone.outbox:
                        self._entries.pop(device, None)
            finally:
                entry.lock.release()
        PHONES.set(len(self._entries))

    def _entry(self, device: Registered) -> _Entry:
        with self._lock:
            # A batch may have been authorised before the consent was withdrawn and come to its end only now.
            if device.id in self._forgotten:
                _refuse_forgotten()
            entry = self._entries.get(device.id)
            if entry is None:
                heading_known = device.carrying in ("hand", "unknown")
                phone = Phone(device.id, self._access_points, self._north, heading_known)
                entry = self._entries[device.id] = _Entry(phone)
                PHONES.set(len(self._entries))
            entry.last_heard = time.monotonic()
            return entry

    def _take(self, entry: _Entry, batch: Batch, received: float) -> BatchReply:
        if entry.forgotten:
            _refuse_forgotten()
        phone = entry.phone
        if len(phone.outbox) > OUTBOX:
            self._flush(entry)
        intake = phone.take(batch, received, self._limits)
        self._flush(entry)
        accepted = intake.accepted
        for kind, count in (("sample", accepted.samples), ("scan", accepted.scans), ("reading", accepted.readings)):
            USED.labels(kind).inc(count)
        for reason, count in intake.ignored.items():
            IGNORED.labels(reason).inc(count)
        return BatchReply(
            seq=batch.seq,
            duplicate=intake.duplicate,
            received=received,
            replied=time.time(),
            clock_offset=intake.clock_offset,
            accepted=accepted,
            ignored=intake.ignored,
        )

    def _flush(self, entry: _Entry) -> None:
        """Publish what waits, in order; the connection is looked at before and after, since a lost put is silent."""
        outbox = entry.phone.outbox
        if not self._bus.connected:
            raise busy("the bus is away; send the batch again with the same seq")
        sent = []
        try:
            while outbox:
                self._publish(entry, outbox[0])
                sent.append(outbox.popleft())
        except Exception as error:
            log.warning("publishing failed", device=entry.phone.device, error=str(error))
            raise busy("the bus refused; send the batch again with the same seq") from error
        if sent and not self._bus.connected:
            outbox.extendleft(reversed(sent))
            raise busy("the bus went away; send the batch again with the same seq")

    def _publish(self, entry: _Entry, message: RadioScan | MotionBatch) -> None:
        device = entry.phone.device
        if isinstance(message, RadioScan):
            if entry.radio is None:
                entry.radio = self._bus.publisher(self._keys.radio(device), RadioScan)
            entry.radio.publish(message)
        else:
            if entry.motion is None:
                entry.motion = self._bus.publisher(self._keys.motion(device), MotionBatch)
            entry.motion.publish(message)


def _refuse_forgotten() -> NoReturn:
    refuse("Authorization", "this device has been forgotten", allowed="enrol again", status=401)
