"""One log of everything that streams tell: ids that are unique and in order, bytes made once, memory that is bounded.

Belongs to one thread (the HTTP event loop). Ids count up by one from where the log began.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterator

from services.api.event_views import without_device

__all__ = ["NOT_YET", "NO_LONGER", "STATE", "Entry", "EventLog", "Framing", "ndjson_event", "sse_event"]

Framing = Callable[[int | None, str, bytes], bytes]
"""How an event (id, name, JSON) travels."""

STATE = frozenset({"tracks", "camera", "occupancy"})
"""Events of which only the newest of a subject counts; each of the others does."""
NO_LONGER, NOT_YET = "older than the log", "of no event of this log"
OVERHEAD = 300
"""Bytes of an entry beside its JSON."""


def sse_event(number: int | None, event: str, payload: bytes) -> bytes:
    """Return one server-sent event."""
    name = b"" if number is None else b"id: %d\n" % number
    return b"event: " + event.encode() + b"\n" + name + b"data: " + payload + b"\n\n"


def ndjson_event(number: int | None, event: str, payload: bytes) -> bytes:
    """Return one line of JSON: ``id``, ``event`` and ``data``."""
    name = b"null" if number is None else b"%d" % number
    return b'{"id":' + name + b',"event":"' + event.encode() + b'","data":' + payload + b"}\n"


class Entry:
    """One event. ``payload`` is its JSON, None once a withdrawn consent left nothing of it."""

    __slots__ = ("_framed", "area", "event", "id", "payload", "subject", "withdrawals", "zone")

    def __init__(
        self, number: int, event: str, subject: str, area: str | None, zone: str | None, payload: bytes | None
    ) -> None:
        self.id = number
        self.event = event
        self.subject = subject
        self.area = area
        self.zone = zone
        self.payload = payload
        self.withdrawals = 0
        """Of the log, how many it has obeyed or need not."""
        self._framed: dict[Framing, bytes] = {}

    @property
    def cost(self) -> int:
        """Bytes it may take: its JSON, and that framed in two ways."""
        return OVERHEAD + 3 * len(self.payload or b"")

    def framed(self, framing: Framing) -> bytes:
        """Return it as it travels; made once for all readers."""
        made = self._framed.get(framing)
        if made is None:
            made = self._framed[framing] = framing(self.id, self.event, self.payload or b"")
        return made

    def erased(self, device: str) -> Entry:
        """Return it without a device; the same where it does not name it."""
        if self.payload is None or device.encode() not in self.payload:
            return self
        payload = without_device(self.event, self.payload, device)
        return Entry(self.id, self.event, self.subject, self.area, self.zone, payload)


class EventLog:
    """The newest events.

    Args:
        first: id of the first event.
        most: events held.
        most_bytes: memory they may take; the newest event is held whatever it takes.
    """

    def __init__(self, first: int, most: int, most_bytes: int) -> None:
        self.oldest = first
        self.newest = first - 1
        self._most, self._most_bytes = most, most_bytes
        self._entries: dict[int, Entry] = {}
        self._present: dict[tuple[str, str], Entry] = {}
        self._withdrawals: deque[tuple[int, str]] = deque()
        """The newest event when a consent was withdrawn, and the device; obeyed when an event is told the next time."""
        self._obeyed_by_all = 0
        self.bytes = 0

    def append(self, event: str, subject: str, area: str | None, zone: str | None, payload: bytes) -> Entry:
        """Add an event; the oldest give way."""
        entry = Entry(self.newest + 1, event, subject, area, zone, payload)
        self.newest = entry.id
        entry.withdrawals = self._obeyed_by_all + len(self._withdrawals)
        self._entries[entry.id] = entry
        self.bytes += entry.cost
        while len(self._entries) > self._most or (self.bytes > self._most_bytes and len(self._entries) > 1):
            self.bytes -= self._entries.pop(self.oldest).cost
            self.oldest += 1
        while self._withdrawals and self._withdrawals[0][0] < self.oldest:
            self._withdrawals.popleft()
            self._obeyed_by_all += 1
        if event in STATE:
            self._present[event, subject] = entry
        return entry

    def refusal(self, number: int) -> str | None:
        """Say why nobody can resume after event ``number``; None: nothing that came after it is gone."""
        if number > self.newest:
            return NOT_YET
        return NO_LONGER if number < self.oldest - 1 else None

    def after(self, number: int) -> Iterator[Entry]:
        """Yield the events after ``number``, which is no older than ``refusal`` allows."""
        for following in range(number + 1, self.newest + 1):
            yield self._obedient(self._entries[following])

    def alert(self, alert_id: str) -> int | None:
        """Return the id of the event that told an alert, None where it is not held (any more)."""
        held = (entry.id for entry in self._entries.values() if entry.event == "alert" and entry.subject == alert_id)
        return next(held, None)

    def present(self, event: str) -> list[Entry]:
        """Return the newest event of each subject, oldest first."""
        return sorted((entry for (name, _), entry in self._present.items() if name == event), key=lambda e: e.id)

    def erase(self, device: str) -> None:
        """Take a device whose consent was withdrawn out of all that can still be told."""
        self._withdrawals.append((self.newest, device))
        self._present = {key: entry.erased(device) for key, entry in self._present.items()}

    def _obedient(self, entry: Entry) -> Entry:
        """Return an event without the devices that were withdrawn since it was written."""
        total = self._obeyed_by_all + len(self._withdrawals)
        if entry.withdrawals == total:
            return entry
        told = entry
        for _, device in itertools.islice(self._withdrawals, max(0, entry.withdrawals - self._obeyed_by_all), None):
            told = told.erased(device)
        told.withdrawals = total
        self._entries[entry.id] = told
        self.bytes += told.cost - entry.cost
        return told
