"""The life of a process, the same for every service.

Read and check settings, open the site and the bus, announce itself, serve ``/healthz``, ``/readyz`` and ``/metrics``,
run, and stop cleanly within five seconds of SIGTERM or Ctrl-C.
"""

from __future__ import annotations

import contextlib
import gc
import json
import logging
import os
import signal
import sys
import threading
from abc import ABC, abstractmethod
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import ClassVar, Generic, NoReturn, TypeVar, cast

import structlog
from prometheus_client import CONTENT_TYPE_LATEST, Gauge, generate_latest

from shared.bus import Bus, BusError, BusTimeoutError
from shared.kept import encode_kept
from shared.keys import Keys
from shared.settings import ServiceSettings, SettingsError, read_settings
from shared.site import Site, SiteError, load_site

__all__ = ["LAUNCHED", "Health", "Service", "ServiceError", "run", "setup_logging"]

S = TypeVar("S", bound=ServiceSettings)

STOP_WITHIN = 5.0
LAUNCHED = "ATRIUM_LAUNCHED"
"""Set to 1 by a launcher that holds the process's standard input open for as long as it lives."""
log = structlog.get_logger(__name__)

_problems_gauge = Gauge("atrium_problems", "Number of problems the service reports of itself")


class ServiceError(RuntimeError):
    """The service cannot do its work: one line in plain words for the operator; the process exits with status 1."""


class Health:
    """What a process says of itself: problems by topic in plain words, and whether it is ready for work."""

    def __init__(self) -> None:
        self._problems: dict[str, str] = {}
        self._lock = threading.Lock()
        self.ready = threading.Event()
        _problems_gauge.set_function(lambda: float(len(self.problems())))

    def degraded(self, topic: str, reason: str) -> None:
        """Tell that ``topic`` is not well, and why; logged when the reason changes."""
        with self._lock:
            known = self._problems.get(topic)
            self._problems[topic] = reason
        if known != reason:
            log.warning("degraded", topic=topic, reason=reason)

    def well(self, topic: str) -> None:
        """Tell that ``topic`` is well again."""
        with self._lock:
            known = self._problems.pop(topic, None)
        if known is not None:
            log.info("recovered", topic=topic, after=known)

    def forget(self) -> None:
        """Forget all problems: whoever told of them is gone, and what begins looks anew."""
        with self._lock:
            self._problems.clear()

    def problems(self) -> dict[str, str]:
        """Return the present problems by topic."""
        with self._lock:
            return dict(self._problems)


class Service(ABC, Generic[S]):
    """One service: subclasses set ``name`` and ``Settings`` and implement ``run``.

    ``run`` works until ``self.stopping`` is set and then returns within a second or two; the runner closes the bus.
    """

    name: ClassVar[str]
    Settings: ClassVar[type[ServiceSettings]]

    def __init__(self, settings: S, site: Site, bus: Bus, health: Health) -> None:
        self.settings = settings
        self.site = site
        self.bus = bus
        self.health = health
        self.keys = Keys(site.site)
        self.stopping = threading.Event()
        self.next_site: Site | None = None
        """The site this service is to begin anew with, once ``run`` has returned."""

    @classmethod
    def check(cls, settings: S, site: Site) -> None:
        """Refuse settings that do not fit the site, before anything opens.

        Raises:
            SettingsError: naming setting, value and what is allowed.
        """

    @property
    def instance(self) -> str:
        """Name of this process among its kind."""
        return self.settings.instance or "0"

    @abstractmethod
    def run(self) -> None:
        """Do the service's work until ``self.stopping`` is set."""

    def begin_anew(self, site: Site) -> None:
        """Stop, and let a new service of this process begin with another site: what is saved at a stop goes on."""
        self.next_site = site
        self.stop()

    def stop(self) -> None:
        """Ask the service to stop; called from a thread of its own. Extend to wake up whatever ``run`` waits for."""
        self.stopping.set()


def main(kind: type[Service[S]]) -> NoReturn:
    """Live the life of one service process, and end the process.

    Without the interpreter's own end: while it takes itself apart, a thread of the bus that reports one thing more is
    unwound through code that is not Python and aborts the process (CPython before 3.14), and to search all a service
    held for circles takes most of a second. What has to be kept or told was by ``run``.
    """
    status = run(kind)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # its reader has gone
            stream.flush()
    os._exit(status)


def run(kind: type[Service[S]], arguments: Sequence[str] | None = None) -> int:
    """Live the life of one service process and return its exit status."""
    try:
        settings = cast(S, read_settings(kind.Settings, arguments, f"python -m services.{kind.name}"))
        site = load_site(settings.site_file)
        kind.check(settings, site)
    except (SettingsError, SiteError) as error:
        print(f"{kind.name}: {error}", file=sys.stderr)  # noqa: T201 (before logging exists)
        return 2
    setup_logging(settings.log_level, settings.log_format, kind.name)
    gc.collect()
    gc.freeze()  # what was imported stays: to look through it again and again for circles stops all threads meanwhile
    log.info("starting", **{key: str(value) for key, value in settings.shown().items()})
    return _live(kind, settings, site)


def _live(kind: type[Service[S]], settings: S, site: Site) -> int:
    """Everything after the settings are known to be right."""
    health = Health()
    stop_requested = threading.Event()
    link = _Link(settings.bus)
    service: Service[S] | None = None

    def stop(signum: int) -> None:
        log.info("stopping", signal=signal.Signals(signum).name)
        if service is not None:
            service.stop()

    def request_stop(signum: int, _frame: object) -> None:
        if stop_requested.is_set():
            return
        stop_requested.set()
        # If the service hangs, leave all the same: a supervisor's patience is limited.
        watchdog = threading.Timer(STOP_WITHIN - 0.5, _leave)
        watchdog.daemon = True
        watchdog.start()
        # The interrupted main thread may hold the log's lock or one of the service's own: stop from another thread.
        threading.Thread(target=stop, args=(signum,), name="stop", daemon=True).start()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, request_stop)
    if os.environ.get(LAUNCHED) == "1":
        threading.Thread(target=_outlive_nobody, name="launcher watch", daemon=True).start()
    try:
        server = _serve_health(settings, health, link)
    except OSError as error:
        log.error("cannot start", reason=f"health port {settings.health_host}:{settings.health_port}: {error.strerror}")
        return 1
    status = 0
    try:
        following: Site | None = site
        while following is not None and not stop_requested.is_set():
            link.open(stop_requested)
            if link.bus is None:
                break
            service = kind(settings, following, link.bus, health)
            link.bus.announce(service.keys.alive(kind.name, service.instance))
            link.bus.answer(
                service.keys.health(kind.name, service.instance), lambda: json.dumps(health.problems()).encode()
            )
            link.bus.answer(service.keys.kept(kind.name, service.instance), lambda: encode_kept(settings.kept()))
            if not stop_requested.is_set():
                service.run()
            following = service.next_site
            if following is not None:
                log.info("beginning anew: the site was set up anew")
                link.close()
                health.forget()
    except (BusError, ServiceError) as error:
        log.error("cannot go on", reason=str(error))
        status = 1
    except Exception:
        log.exception("crashed")
        status = 1
    finally:
        server.shutdown()
        link.close()
        log.info("stopped", status=status)
    return status


class _Link:
    """The bus as the health page sees it: perhaps not open yet."""

    def __init__(self, endpoints: list[str]) -> None:
        self.endpoints = endpoints
        self.bus: Bus | None = None

    @property
    def connected(self) -> bool:
        return self.bus is not None and self.bus.connected

    def open(self, stop_requested: threading.Event) -> None:
        """Wait for a router; ``bus`` stays None when the process is asked to stop meanwhile.

        Raises:
            BusError: an endpoint is malformed.
        """
        where = ", ".join(self.endpoints)
        notice = threading.Timer(1.0, lambda: log.warning("waiting for a router", endpoints=where))
        notice.daemon = True
        notice.start()
        with contextlib.suppress(BusTimeoutError):
            self.bus = Bus(self.endpoints, stopping=stop_requested)
        notice.cancel()

    def close(self) -> None:
        bus, self.bus = self.bus, None
        if bus is not None:
            bus.close()


def setup_logging(level: str, form: str, service: str = "") -> None:
    """Send structured logs to standard error, as text for people or as JSON for machines.

    ``service`` is named in every line, whichever thread writes it (context variables reach one thread only).
    """

    def name_service(_logger: object, _method: str, event: structlog.typing.EventDict) -> structlog.typing.EventDict:
        if service:
            event.setdefault("service", service)
        return event

    renderer: structlog.typing.Processor = (
        structlog.processors.JSONRenderer()
        if form == "json"
        else structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty())
    )
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            name_service,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            renderer,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(getattr(logging, level.upper())),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
        cache_logger_on_first_use=False,
    )
    logging.basicConfig(
        level=logging.WARNING, stream=sys.stderr, format="%(levelname)s %(name)s %(message)s", force=True
    )


def _outlive_nobody() -> None:
    """Stop when the launcher is gone, however it went: it alone holds the other end of our standard input."""
    # Not through sys.stdin: its buffer's lock, held by a thread that waits, aborts the interpreter at exit.
    while os.read(0, 4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def _leave() -> None:
    last_resort = threading.Timer(0.3, os._exit, (3,))  # writing the log may block too, on a full pipe
    last_resort.daemon = True
    last_resort.start()
    log.error("did not stop in time, leaving", seconds=STOP_WITHIN)
    os._exit(3)


def _serve_health(settings: ServiceSettings, health: Health, link: _Link) -> ThreadingHTTPServer:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            path = self.path.partition("?")[0]
            if path == "/metrics":
                self._send(200, CONTENT_TYPE_LATEST, generate_latest())
            elif path == "/healthz":
                self._send_json(200, {"status": "alive", "problems": health.problems()})
            elif path == "/readyz":
                problems = health.problems()
                connected = link.connected
                if not connected:
                    problems["bus"] = f"no router at {', '.join(settings.bus)}"
                if not health.ready.is_set():
                    problems["service"] = "still starting"
                ready = connected and health.ready.is_set()
                self._send_json(200 if ready else 503, {"ready": ready, "problems": problems})
            else:
                self._send_json(404, {"detail": "only /healthz, /readyz and /metrics live here"})

        def _send_json(self, status: int, body: dict[str, object]) -> None:
            self._send(status, "application/json", json.dumps(body).encode())

        def _send(self, status: int, content_type: str, body: bytes) -> None:
            self.send_response(status)
            self.send_header("Content-Type", content_type)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            """Keep probes out of the log."""

    server = ThreadingHTTPServer((settings.health_host, settings.health_port), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, name="health", daemon=True).start()
    log.info("health", url=f"http://{settings.health_host}:{server.server_address[1]}/healthz")
    return server
