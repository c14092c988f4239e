"""What do the site's receivers hear of enrolled transmitters? Tags are heard, instead of phones hearing.

A transmitter that is not enrolled is dropped here before anything else happens: before any queue, log or label of a
metric; it is counted as a number. What all receivers heard of one device within a second becomes one RadioScan on the
bus, receivers named by the access points they stand at. Readings are not acknowledged: while the bus is away the newest
are kept, and those that had to give way are counted.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter as Tally
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import msgspec
import structlog
from prometheus_client import Counter

from services.gateway.devices.storage import Registered
from services.gateway.devices.transmitters import digest_of
from services.gateway.phones.heard import Heard
from shared.bus import Bus, Publisher
from shared.keys import Keys
from shared.messages import RadioScan
from shared.site import Site

__all__ = ["ReceiverBook"]

READINGS = Counter("atrium_gateway_receiver_readings_total", "What the site's receivers heard", ["result"])
SCANS = Counter("atrium_gateway_receiver_scans_total", "Scans made of it", ["result"])
WINDOW = 1.0
"""s: what is heard of a device within it becomes one scan."""
OLDEST, NEWEST = 60.0, 2.0
"""s before and after its arrival between which a receiver's stamp is believed. FIND3 stamps the begin of a scan."""
PENDING = 256
"""Readings of one device that wait for the end of a window; the oldest give way."""
OUTBOX = 10_000
"""Scans that wait for the bus; the oldest give way."""
PUBLISHERS = 1000
"""Devices whose publisher stays open."""
STRANGERS = 100
"""Unknown receivers that the operator is told of by name."""

log = structlog.get_logger(__name__)


class _Reading(NamedTuple):
    t: float
    kind: Literal["wifi", "ble"]
    access_point: str
    rssi: float


@dataclass(slots=True)
class _Device:
    opened: float
    """Monotonic, when its window was opened."""
    readings: deque[_Reading] = field(default_factory=lambda: deque(maxlen=PENDING))


class ReceiverBook:
    """Takes readings of receivers from any thread.

    Args:
        site: says which receivers stand at which access point.
        bus: where scans go.
        enrolled: returns who transmits, by digest of the address (``DeviceStore.devices_by_digest``).
        address_key: of the digests.
        lateness: s after which a scan is marked late.
        clock: monotonic, s.
    """

    def __init__(
        self,
        site: Site,
        bus: Bus,
        enrolled: Callable[[], Mapping[str, Registered]],
        address_key: str,
        lateness: float = 5.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._bus = bus
        self._keys = Keys(site.site)
        self._enrolled = enrolled
        self._address_key = address_key
        self._lateness = lateness
        self._clock = clock
        self._points = {_plain(name): point.id for point in site.access_points for name in point.receivers}
        self._lock = threading.Lock()
        self._known: dict[str, str] = {}
        self._changes = 0
        self._waiting: dict[str, _Device] = {}
        self._outbox: deque[RadioScan] = deque()
        self._seq: dict[str, int] = {}
        self._publishers: OrderedDict[str, Publisher[RadioScan]] = OrderedDict()
        self._outdated = threading.Event()
        self._outdated.set()
        self._told: set[str] = set()

    def knows(self, receiver: str) -> bool:
        """Whether the site file names this receiver; the operator is told once of one that it does not name."""
        if _plain(receiver) in self._points:
            return True
        with self._lock:
            new = len(self._told) < STRANGERS and _plain(receiver) not in self._told
            if new:
                self._told.add(_plain(receiver))
        if new:
            shown = receiver[:64].encode("unicode_escape").decode()
            log.warning("a receiver reports that no access point of the site file names", receiver=shown)
        return False

    def expect_news(self) -> None:
        """Say that somebody has enrolled: the database is asked again within a fifth of a second."""
        self._outdated.set()

    def refresh(self) -> None:
        """Ask the database who is enrolled now."""
        self._outdated.clear()
        with self._lock:
            before = self._changes
        known = {digest: device.id for digest, device in self._enrolled().items()}
        with self._lock:
            if self._changes == before:
                self._known = known
                owners = set(known.values())
                self._seq = {device: seq for device, seq in self._seq.items() if device in owners}
            else:  # somebody has withdrawn meanwhile: the answer may be outdated
                self._outdated.set()

    def forget(self, device: str) -> None:
        """Forget a device whose consent was withdrawn: its transmitters, and what of it is not yet on the bus."""
        with self._lock:
            self._changes += 1
            self._known = {digest: owner for digest, owner in self._known.items() if owner != device}
            self._waiting.pop(device, None)
            self._outbox = deque(scan for scan in self._outbox if scan.device != device)
            self._seq.pop(device, None)
            publisher = self._publishers.pop(device, None)
        if publisher is not None:
            publisher.close()

    def take(self, heard: Iterable[Heard], received: float) -> dict[str, int]:
        """Keep what was heard of enrolled transmitters by known receivers; return how many came to what.

        Args:
            heard: readings.
            received: server clock at their arrival.
        """
        results: Tally[str] = Tally()
        for reading in heard:
            results[self._take(reading, received)] += 1
        for result, count in results.items():
            READINGS.labels(result).inc(count)
        return dict(results)

    def _take(self, reading: Heard, received: float) -> str:
        if not self.knows(reading.receiver):
            return "unknown receiver"
        t = received
        if reading.t is not None and received - OLDEST <= reading.t <= received + NEWEST:
            t = reading.t
        digests = [digest_of(name, self._address_key) for name in reading.names]
        with self._lock:  # looked up under the lock: a device being forgotten does not come back
            owner = next((self._known[digest] for digest in digests if digest in self._known), None)
            if owner is None:
                return "not enrolled"
            waiting = self._waiting.setdefault(owner, _Device(self._clock()))
            if len(waiting.readings) == PENDING:
                READINGS.labels("given up").inc()
            waiting.readings.append(_Reading(t, reading.kind, self._points[_plain(reading.receiver)], reading.rssi))
        return "used"

    def flush(self) -> None:
        """Make scans of the windows that have ended and publish what waits."""
        now = self._clock()
        with self._lock:
            ended = [device for device, waiting in self._waiting.items() if now >= waiting.opened + WINDOW]
            for device in ended:
                self._outbox.extend(self._scans(device, self._waiting.pop(device).readings))
            lost = len(self._outbox) - OUTBOX
            for _ in range(lost):
                self._outbox.popleft()
        if lost > 0:
            SCANS.labels("given up").inc(lost)
        while self._bus.connected and self._publish_one():
            pass

    def run(self, stopping: threading.Event, refresh: float) -> None:
        """Flush until asked to stop, and ask the database again every ``refresh`` seconds; what a thread runs."""
        due = self._clock()
        while not stopping.wait(WINDOW / 5.0):
            try:
                if self._outdated.is_set() or self._clock() >= due:
                    due = self._clock() + refresh
                    self.refresh()
                self.flush()
            except Exception as error:
                log.warning("what receivers heard could not be told; trying again", error=type(error).__name__)

    def _scans(self, device: str, readings: Iterable[_Reading]) -> Iterable[RadioScan]:
        """Yield one scan per kind and second of measurement; a receiver that heard it often says the mean."""
        group: list[_Reading] = []
        for reading in sorted(readings, key=lambda reading: (reading.kind, reading.t)):
            if group and (reading.kind != group[0].kind or reading.t >= group[0].t + WINDOW):
                yield self._scan(device, group)
                group = []
            group.append(reading)
        if group:
            yield self._scan(device, group)

    def _scan(self, device: str, group: list[_Reading]) -> RadioScan:
        levels: dict[str, list[float]] = {}
        for reading in group:
            levels.setdefault(reading.access_point, []).append(reading.rssi)
        seq = self._seq[device] = self._seq.get(device, -1) + 1
        return RadioScan(
            t=group[-1].t,
            device=device,
            seq=seq,
            kind=group[0].kind,
            access_point=list(levels),
            rssi=[math.fsum(heard) / len(heard) for heard in levels.values()],
            heard_by_site=True,
        )

    def _publish_one(self) -> bool:
        """Publish the scan that waits longest; False where none does. Under the lock: forgetting waits for it."""
        with self._lock:
            if not self._outbox:
                return False
            scan = self._outbox[0]
            publisher = self._publisher(scan.device)
            late = time.time() - scan.t > self._lateness
            publisher.publish(msgspec.structs.replace(scan, late=late))
            self._outbox.popleft()
        SCANS.labels("late" if late else "live").inc()
        return True

    def _publisher(self, device: str) -> Publisher[RadioScan]:
        publisher = self._publishers.get(device)
        if publisher is None:
            publisher = self._publishers[device] = self._bus.publisher(self._keys.radio(device), RadioScan)
            if len(self._publishers) > PUBLISHERS:
                self._publishers.popitem(last=False)[1].close()
        self._publishers.move_to_end(device)
        return publisher


def _plain(receiver: str) -> str:
    return receiver.strip().casefold()
