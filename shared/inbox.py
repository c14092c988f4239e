"""What waits for a service: messages as they came from the bus, and the account of those that were dropped.

No work happens in a Zenoh callback: it appends raw bytes to a bounded queue and the service decodes them in its own
thread. Every message that does not reach its reader is counted by reason in ``atrium_bus_dropped_total``.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import msgspec
import structlog
import zenoh
from prometheus_client import Counter

from shared.messages import Message, MessageError, decode

__all__ = ["DROPPED", "Delivery", "Inbox", "Trace"]

M_co = TypeVar("M_co", bound=Message, covariant=True)

log = structlog.get_logger(__name__)

RECEIVED = Counter("atrium_bus_received_total", "Messages handed to the service", ["kind"])
DROPPED = Counter("atrium_bus_dropped_total", "Messages that did not reach the service", ["kind", "reason"])

_KEYS_REMEMBERED = 10_000


class Trace(msgspec.Struct, frozen=True, array_like=True):
    """What travels beside a message: who it is, when its origin was *received* here, when it was sent (wall clock)."""

    id: str
    origin: float
    sent: float


@dataclass(frozen=True, slots=True)
class Delivery(Generic[M_co]):
    """One message as it arrived, at ``arrived`` by this process's monotonic clock."""

    key: str
    message: M_co
    trace: Trace
    arrived: float


_decode_trace = msgspec.json.Decoder(Trace).decode


class _Source(Protocol):
    """Where messages come from: the bus."""

    def _subscribe(self, key: str, arrive: Callable[[zenoh.Sample], None], cached: bool) -> None: ...


@dataclass(frozen=True, slots=True)
class _Waiting:
    """One message as it came, not yet looked into."""

    key: str
    payload: bytes
    attachment: bytes | None
    kind: type[Message]
    arrived: float


class _CountByKey:
    """How many messages of each key; a bounded number of keys, since they come from outside."""

    def __init__(self) -> None:
        self._counts: OrderedDict[str, int] = OrderedDict()

    def add(self, key: str, count: int) -> None:
        self._counts[key] = self._counts.pop(key, 0) + count
        if len(self._counts) > _KEYS_REMEMBERED:
            self._counts.popitem(last=False)

    def take(self, key: str) -> int:
        return self._counts.pop(key, 0)

    def take_all(self) -> list[tuple[str, int]]:
        counts = list(self._counts.items())
        self._counts.clear()
        return counts


class Inbox:
    """One bounded queue into which any number of subscriptions flow, in order of arrival.

    Of a key subscribed to with ``newest=True`` a few messages wait at most; the oldest gives way to the next. When the
    whole queue is full, the oldest of all such messages is dropped, or the oldest reliable one where only those wait.
    All are counted.
    """

    def __init__(self, bus: _Source, capacity: int) -> None:
        self._bus = bus
        self._capacity = capacity
        self._changed = threading.Condition()
        self._woken = False
        self._arrivals = itertools.count()
        # By number of arrival, so that any message can be dropped at once, wherever it stands.
        self._waiting: OrderedDict[int, _Waiting] = OrderedDict()
        self._giving_way: OrderedDict[int, None] = OrderedDict()
        self._of_key: dict[str, deque[int]] = {}
        self._dropped = _CountByKey()
        """Numbered messages dropped since the last ``receive``: all of them older than what waits of their key."""
        self._missing = _CountByKey()
        """The reader's own: numbered messages dropped here, by which the next number of their key may jump."""
        self._problems: dict[tuple[str, str], int] = {}
        self._last_report = time.monotonic()
        self._last_seq: OrderedDict[str, int] = OrderedDict()

    def subscribe(
        self, key: str, kind: type[Message], *, newest: bool = False, cached: bool = False, depth: int = 8
    ) -> None:
        """Let messages of type ``kind`` on ``key`` (wildcards allowed) flow into this inbox.

        Args:
            key: a key expression from ``shared.keys``.
            kind: the message type found there.
            newest: these messages may be dropped for newer ones when the reader falls behind.
            cached: also fetch what publishers of this key sent before this subscription began.
            depth: how many messages of each single key wait at most, where ``newest``.

        Raises:
            ValueError: ``depth`` is less than one.
        """
        if depth < 1:
            raise ValueError(f"depth: {depth} messages of a key may wait; allowed: 1 and more")

        def arrive(sample: zenoh.Sample) -> None:
            attachment = sample.attachment
            entry = _Waiting(
                str(sample.key_expr),
                sample.payload.to_bytes(),
                None if attachment is None else attachment.to_bytes(),
                kind,
                time.monotonic(),
            )
            with self._changed:
                self._append(entry, depth if newest else None)
                self._changed.notify()

        self._bus._subscribe(key, arrive, cached)

    def receive(self, timeout: float) -> list[Delivery[Message]]:
        """Wait up to ``timeout`` seconds for messages and return all that wait, oldest first (possibly none)."""
        with self._changed:
            if not self._waiting and not self._woken:
                self._changed.wait(timeout)
            self._woken = False
            entries = list(self._waiting.values())
            self._waiting.clear()
            self._giving_way.clear()
            self._of_key.clear()
            dropped = self._dropped.take_all()
        for key, count in dropped:
            self._missing.add(key, count)
        deliveries = [delivery for entry in entries if (delivery := self._open(entry)) is not None]
        self._report()
        return deliveries

    def wake(self) -> None:
        """Make the waiting ``receive``, or the next one, return at once."""
        with self._changed:
            self._woken = True
            self._changed.notify_all()

    def _append(self, entry: _Waiting, depth: int | None) -> None:
        """Let one message wait; with a ``depth``, no more than so many of its key."""
        number = next(self._arrivals)
        if depth is not None and len(self._of_key.get(entry.key, ())) >= depth:
            self._overtake(self._of_key[entry.key][0])
        if len(self._waiting) >= self._capacity:
            if self._giving_way:
                self._overtake(next(iter(self._giving_way)))
            else:
                self._count_drop(self._waiting.popitem(last=False)[1], "queue full")
        self._waiting[number] = entry
        if depth is not None:
            self._giving_way[number] = None
            self._of_key.setdefault(entry.key, deque()).append(number)

    def _overtake(self, number: int) -> None:
        """Drop a message that may give way; it is always the oldest of its key."""
        entry = self._waiting.pop(number)
        del self._giving_way[number]
        of_key = self._of_key[entry.key]
        of_key.popleft()
        if not of_key:
            del self._of_key[entry.key]
        self._count_drop(entry, "overtaken")

    def _count_drop(self, entry: _Waiting, reason: str) -> None:
        self._note(entry.kind.__name__, reason)
        if _is_numbered(entry.kind):
            self._dropped.add(entry.key, 1)

    def _open(self, entry: _Waiting) -> Delivery[Message] | None:
        kind = entry.kind
        try:
            message = decode(entry.payload, kind)
            trace = Trace("", message.t, message.t) if entry.attachment is None else _decode_trace(entry.attachment)
        except (MessageError, msgspec.DecodeError) as error:
            self._note(kind.__name__, "not understood")
            if _is_numbered(kind):
                self._missing.add(entry.key, 1)
            log.debug("message not understood", key=entry.key, error=str(error))
            return None
        RECEIVED.labels(kind.__name__).inc()
        self._count_gap(entry.key, message)
        return Delivery(entry.key, message, trace, entry.arrived)

    def _count_gap(self, key: str, message: Message) -> None:
        """Count what a publisher numbered but never arrived, as when the router was away; not what was dropped here."""
        seq = getattr(message, "seq", None)
        if seq is None:
            return
        missing = self._missing.take(key)
        last = self._last_seq.pop(key, seq - 1)
        self._last_seq[key] = seq
        if len(self._last_seq) > _KEYS_REMEMBERED:
            self._last_seq.popitem(last=False)
        gap = seq - last - 1 - missing
        if gap > 0:  # a smaller number is a publisher that started anew
            self._note(type(message).__name__, "gap", gap)

    def _note(self, kind: str, reason: str, count: int = 1) -> None:
        DROPPED.labels(kind, reason).inc(count)
        with self._changed:  # Zenoh's threads count too
            self._problems[kind, reason] = self._problems.get((kind, reason), 0) + count

    def _report(self) -> None:
        """Tell about dropped messages in the log, once a minute at most."""
        with self._changed:
            if not self._problems or time.monotonic() - self._last_report < 60.0:
                return
            problems, self._problems = self._problems, {}
            self._last_report = time.monotonic()
        for (kind, reason), count in problems.items():
            log.warning("messages dropped", kind=kind, reason=reason, count=count)


def _is_numbered(kind: type[Message]) -> bool:
    return "seq" in kind.__struct_fields__
