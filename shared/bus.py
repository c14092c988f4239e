"""The bus: typed publishers and inboxes over Eclipse Zenoh.

Trace id and wall-clock stamps travel in the attachment, apart from the message, so that messages stay a pure function
of the data.
"""

from __future__ import annotations

import itertools
import json
import os
import re
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any, Generic, TypeVar

import msgspec
import structlog
import zenoh
import zenoh.ext
from prometheus_client import Counter, Gauge

from shared.inbox import DROPPED, Delivery, Inbox, Trace
from shared.messages import Message, encode

__all__ = [
    "DROPPED",
    "Bus",
    "BusError",
    "BusTimeoutError",
    "Delivery",
    "Inbox",
    "Publisher",
    "Question",
    "Trace",
    "router",
]

M = TypeVar("M", bound=Message)

log = structlog.get_logger(__name__)

PUBLISHED = Counter("atrium_bus_published_total", "Messages published", ["kind"])
CONNECTED = Gauge("atrium_bus_connected", "1 while a router is reachable")


QUEUE = 16
"""Messages of one priority that wait for a link, the most Zenoh takes. Its default of two is less than the cameras of
one area send at once: the others were lost whenever a link's thread, or its reader, was not scheduled within 1 ms."""
LONGEST_WAIT = 20_000
"""Microseconds a message that may be dropped waits for room in a full queue; once one was dropped, others do not wait.
Less than the interval of a camera, so that a camera whose bus is crowded loses frames and falls not behind."""


class BusError(RuntimeError):
    """The bus could not be opened: the text names the endpoint and the reason."""


class BusTimeoutError(BusError):
    """No router was reachable in the time given."""


_encode_trace = msgspec.json.Encoder().encode


class Publisher(Generic[M]):
    """Publishes messages of one type on one key."""

    def __init__(
        self,
        put: Callable[..., None],
        kind: type[M],
        undeclare: Callable[[], None],
        matching: Callable[[], bool],
        new_trace: Callable[[], str],
    ) -> None:
        self._new_trace = new_trace
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
        trace = Trace(self._new_trace(), now if origin is None else origin, now)
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


class Question:
    """A query that carries a payload; it is answered once, from any thread."""

    def __init__(self, key: str, query: zenoh.Query) -> None:
        self._key = key
        self._query = query
        self.payload = b"" if query.payload is None else query.payload.to_bytes()

    def answer(self, payload: bytes) -> None:
        """Answer in JSON; whoever asked may have given up."""
        with self._query as query:
            query.reply(self._key, payload, encoding=zenoh.Encoding.APPLICATION_JSON)


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
        # Of the session, not of the process: a service that begins anew is told from the one before by it.
        prefix, numbers = f"{os.getpid():x}-{time.time_ns() // 1000 % 2**32:x}", itertools.count(1)
        self._new_trace = lambda: f"{prefix}-{next(numbers)}"
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

        return Publisher(
            declared.put, kind, undeclare, lambda: bool(declared.matching_status.matching), self._new_trace
        )

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

    def answer_questions(self, key: str, take: Callable[[Question], None]) -> None:
        """Hand queries on ``key`` that say something to ``take``, which must be quick; it may answer later."""

        def receive(query: zenoh.Query) -> None:
            try:
                take(Question(key, query))
            except Exception:
                log.exception("query not answered", key=key)
                query.drop()  # type: ignore[no-untyped-call]

        self._declared.append(self._session.declare_queryable(key, receive))

    def ask(self, key: str, timeout: float = 5.0, payload: bytes | None = None) -> Iterator[tuple[str, bytes]]:
        """Yield (key, payload) of every answer to a query on ``key``, which may carry a ``payload`` of its own."""
        for reply in self._session.get(key, timeout=timeout, payload=payload):
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
    config.insert_json5("transport/link/tx/queue/size/data", str(QUEUE))
    config.insert_json5("transport/link/tx/queue/congestion_control/drop/wait_before_drop", str(LONGEST_WAIT))
    config.insert_json5("timestamping/enabled", "true")  # caches order their samples by it
