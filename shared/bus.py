"""The bus: typed publishers and inboxes over Eclipse Zenoh.

No work happens in a Zenoh callback: it appends raw bytes to a bounded queue and the service decodes them in its own
thread. Every message that does not reach its reader is counted by reason in ``atrium_bus_dropped_total``. Trace id and
wall-clock stamps travel in the attachment, apart from the message, so that messages stay a pure function of the data.
"""

from __future__ import annotations

import itertools
import json
import os
import re
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import msgspec
import structlog
import zenoh
import zenoh.ext
from prometheus_client import Counter, Gauge

from shared.messages import Message, MessageError, decode, encode

__all__ = ["Bus", "BusError", "BusTimeoutError", "Delivery", "Inbox", "Publisher", "Trace", "router"]

M = TypeVar("M", bound=Message)
M_co = TypeVar("M_co", bound=Message, covariant=True)

log = structlog.get_logger(__name__)

RECEIVED = Counter("atrium_bus_received_total", "Messages handed to the service", ["kind"])
PUBLISHED = Counter("atrium_bus_published_total", "Messages published", ["kind"])
DROPPED = Counter("atrium_bus_dropped_total", "Messages that did not reach the service", ["kind", "reason"])
CONNECTED = Gauge("atrium_bus_connected", "1 while a router is reachable")


class BusError(RuntimeError):
    """The bus could not be opened: the text names the endpoint and the reason."""


class BusTimeoutError(BusError):
    """No router was reachable in the time given."""


class Trace(msgspec.Struct, frozen=True, array_like=True):
    """What travels beside a message: who it is, when its origin was *received* here, when it was sent (wall clock)."""

    id: str
    origin: float
    sent: float


@dataclass(frozen=True, slots=True)
class Delivery(Generic[M_co]):
    """One message as it arrived."""

    key: str
    message: M_co
    trace: Trace


_KEYS_REMEMBERED = 10_000
_trace_prefix = f"{os.getpid():x}-{time.time_ns() // 1000 % 2**32:x}"
_trace_number = itertools.count(1)
_encode_trace = msgspec.json.Encoder().encode
_decode_trace = msgspec.json.Decoder(Trace).decode


class Publisher(Generic[M]):
    """Publishes messages of one type on one key."""

    def __init__(
        self, put: Callable[..., None], kind: type[M], undeclare: Callable[[], None], matching: Callable[[], bool]
    ) -> None:
        self._put = put
        self._matching = matching
        self._undeclare = undeclare
        self._kind = kind
        self._count = PUBLISHED.labels(kind.__name__)

    def publish(self, message: M, origin: float | None = None) -> Trace:
        """Send one message.

        Args:
            message: what to send.
            origin: wall-clock time at which what this message is made from reached the system (now if omitted).

        Returns:
            The trace that travels with it.
        """
        now = time.time()
        trace = Trace(f"{_trace_prefix}-{next(_trace_number)}", now if origin is None else origin, now)
        self._put(encode(message), attachment=_encode_trace(trace))
        self._count.inc()
        return trace

    @property
    def matched(self) -> bool:
        """Whether anybody subscribes to this key now."""
        return self._matching()

    def close(self) -> None:
        """Withdraw the publisher; for keys that come and go, such as a device's. The bus closes all others itself."""
        self._undeclare()


@dataclass(frozen=True, slots=True)
class _Waiting:
    """One message as it came, not yet looked into."""

    key: str
    payload: bytes
    attachment: bytes | None
    kind: type[Message]


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

    def __init__(self, bus: Bus, capacity: int) -> None:
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
        return Delivery(entry.key, message, trace)

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


class Bus:
    """One process's connection to the bus. Zenoh reconnects by itself when its router goes away and comes back.

    Opening waits for a router to be reachable: a session cannot begin without one. Ctrl-C interrupts the wait.

    Args:
        connect: router endpoints such as ``tcp/127.0.0.1:7447``.
        wait: give up after this many seconds; None waits for ever.
        stopping: give up when this is set.

    Raises:
        BusTimeoutError: no router was reachable in time, or ``stopping`` was set.
        BusError: an endpoint is malformed.
    """

    def __init__(
        self, connect: list[str], *, wait: float | None = None, stopping: threading.Event | None = None
    ) -> None:
        config = zenoh.Config()
        try:
            config.insert_json5("mode", '"client"')
            config.insert_json5("connect/endpoints", json.dumps(connect))
            # The session's own patience; how long *we* wait for it is decided in _open.
            config.insert_json5("connect/timeout_ms", "-1")
            config.insert_json5("connect/exit_on_failure", "false")
            config.insert_json5(
                "connect/retry", '{"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2}'
            )
            _common(config)
            self._session = _open(config, wait, stopping)
        except zenoh.ZError as error:
            raise BusError(f"bus: cannot open a session to {', '.join(connect)}: {_reason(error)}") from error
        except TimeoutError as error:
            raise BusTimeoutError(f"bus: no router at {', '.join(connect)}") from error
        self._declared: list[Any] = []
        CONNECTED.set_function(lambda: float(self.connected))

    @property
    def connected(self) -> bool:
        """Whether a router is reachable now."""
        return not self._session.is_closed() and bool(self._session.info.routers_zid())

    def publisher(
        self, key: str, kind: type[M], *, newest: bool = False, cached: bool = False, history: int = 1
    ) -> Publisher[M]:
        """Return a publisher of ``kind`` on ``key``.

        Args:
            key: from ``shared.keys``.
            kind: the message type.
            newest: drop rather than wait when the network is congested (sensor streams).
            cached: keep the last ``history`` messages for subscribers that join later (state).
            history: how many are kept.
        """
        congestion = zenoh.CongestionControl.DROP if newest else zenoh.CongestionControl.BLOCK
        declared: Any
        if cached:
            declared = zenoh.ext.declare_advanced_publisher(
                self._session,
                key,
                encoding=zenoh.Encoding.APPLICATION_JSON,
                congestion_control=congestion,
                cache=zenoh.ext.CacheConfig(history),
                publisher_detection=True,
            )
        else:
            declared = self._session.declare_publisher(
                key, encoding=zenoh.Encoding.APPLICATION_JSON, congestion_control=congestion, express=True
            )
        self._declared.append(declared)

        def undeclare() -> None:
            if declared in self._declared:
                self._declared.remove(declared)
                declared.undeclare()

        return Publisher(declared.put, kind, undeclare, lambda: bool(declared.matching_status.matching))

    def inbox(self, capacity: int = 10_000) -> Inbox:
        """Return a new inbox that holds at most ``capacity`` undelivered messages."""
        return Inbox(self, capacity)

    def announce(self, key: str) -> None:
        """Hold a liveliness token: others see ``key`` exactly as long as this process lives."""
        self._declared.append(self._session.liveliness().declare_token(key))

    def present(self, key: str, timeout: float = 1.0) -> list[str]:
        """Return the liveliness keys that match now."""
        replies = self._session.liveliness().get(key, timeout=timeout)
        return sorted(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)

    def answer(self, key: str, respond: Callable[[], bytes]) -> None:
        """Answer queries on ``key`` with what ``respond`` returns; it is called in a Zenoh thread and must be quick."""

        def reply(query: zenoh.Query) -> None:
            with query:
                try:
                    query.reply(key, respond(), encoding=zenoh.Encoding.APPLICATION_JSON)
                except Exception:
                    # Whoever asked gets no answer; a Zenoh thread is no place to let it fall through silently.
                    log.exception("query not answered", key=key)

        self._declared.append(self._session.declare_queryable(key, reply))

    def ask(self, key: str, timeout: float = 5.0) -> Iterator[tuple[str, bytes]]:
        """Yield (key, payload) of every answer to a query on ``key``."""
        for reply in self._session.get(key, timeout=timeout):
            if reply.ok is not None:
                yield str(reply.ok.key_expr), reply.ok.payload.to_bytes()

    def close(self) -> None:
        """Leave the bus; tokens vanish at once."""
        for declared in reversed(self._declared):
            declared.undeclare()
        self._declared.clear()
        self._session.close()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Bus:
        """Use the bus for the length of a block."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the bus."""
        self.close()

    def _subscribe(self, key: str, arrive: Callable[[zenoh.Sample], None], cached: bool) -> None:
        declared: Any
        if cached:
            declared = zenoh.ext.declare_advanced_subscriber(
                self._session, key, arrive, history=zenoh.ext.HistoryConfig(detect_late_publishers=True)
            )
        else:
            declared = self._session.declare_subscriber(key, arrive)
        self._declared.append(declared)


def router(listen: str) -> zenoh.Session:
    """Open a router inside this process, as the local launcher does; close the session to stop it.

    Raises:
        BusError: the endpoint cannot be listened on.
    """
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([listen]))
    config.insert_json5("listen/exit_on_failure", "true")
    _common(config)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise BusError(f"bus: cannot listen on {listen}: {_reason(error)}") from error


def _open(config: zenoh.Config, wait: float | None, stopping: threading.Event | None) -> zenoh.Session:
    """Open a session in a thread of its own: the wait for a router is native code that no signal could interrupt.

    Raises:
        TimeoutError: given up; should a session open later all the same, it is closed at once.
    """
    opened: Future[zenoh.Session] = Future()

    def work() -> None:
        try:
            session = zenoh.open(config)
        except BaseException as error:
            opened.set_exception(error)
        else:
            opened.set_result(session)

    threading.Thread(target=work, name="bus-open", daemon=True).start()
    deadline = None if wait is None else time.monotonic() + wait
    while True:
        try:
            return opened.result(timeout=0.1)
        except TimeoutError:
            expired = deadline is not None and time.monotonic() >= deadline
            if opened.done() or not (expired or (stopping is not None and stopping.is_set())):
                continue
            opened.add_done_callback(_close_quietly)
            raise


def _close_quietly(opened: Future[zenoh.Session]) -> None:
    if opened.exception() is None:
        opened.result().close()  # type: ignore[no-untyped-call]


def _reason(error: zenoh.ZError) -> str:
    """Return what Zenoh says without the places in its own source code it names."""
    text = re.sub(r" at /\S+?:\d+\.?", "", str(error))
    wrapped = re.search(r'msg: "([^"]*)"', text)
    return wrapped[1] if wrapped else text


def _common(config: zenoh.Config) -> None:
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("scouting/gossip/enabled", "false")
    config.insert_json5("timestamping/enabled", "true")  # caches order their samples by it
