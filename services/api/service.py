"""The api service: from the bus into ``LiveState`` and ``Hub``, and HTTP on top of them."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import msgspec
import structlog
from fastapi import FastAPI

from services.api.admin.administration import Administration
from services.api.alerts.inbox import Told
from services.api.alerts.office import AlertOffice
from services.api.app import create_app
from services.api.erasures import ErasureBoard, OwnErasures
from services.api.event_log import EventLog
from services.api.health_report import Presence, find_wrong, health_report
from services.api.history_link import HistoryLink
from services.api.learning_link import LearningLink
from services.api.live_state import LiveState
from services.api.pseudonyms import Pseudonyms
from services.api.replies import HealthReport
from services.api.settings import DEMO_KEY, ApiSettings
from services.api.setup_news import SetupNews
from services.api.stream import Hub
from services.api.trouble import Finding, TroubleWatch
from shared.acknowledgements import Acknowledgements
from shared.bus import Bus, Delivery
from shared.http_server import serve
from shared.messages import Alert, CameraStatus, Erasure, ErasureDone, Message, Occupancy, Revision, TrackFrame
from shared.runner import Health, Service
from shared.settings import SettingsError
from shared.setup_told import SetupTold
from shared.site import Site
from shared.weak_secrets import why_weak
from shared.zones import ZoneSet

__all__ = ["ApiService"]

log = structlog.get_logger(__name__)

SHORTEST_KEY = 16


class ApiService(Service[ApiSettings]):
    """Serves the present state of the site to staff software."""

    name = "api"
    Settings = ApiSettings

    def __init__(self, settings: ApiSettings, site: Site, bus: Bus, health: Health) -> None:
        super().__init__(settings, site, bus, health)
        self._live = LiveState(site, settings.positions_kept, settings.tracks_kept)
        self._pseudonyms = Pseudonyms()
        own = OwnErasures(("alerts", "books"), Acknowledgements(bus, self.keys, self.name).tell)
        self._alerts = AlertOffice(
            settings, site, self._tell_of_alerts, own.of("alerts"), without=self._pseudonyms.without
        )
        held = settings.stream_events, int(settings.stream_megabytes * 2**20)
        events = EventLog(self._alerts.first_event, *held)
        self._hub = Hub(
            events,
            settings.stream_rate,
            settings.stream_keep_alive,
            settings.stream_readers,
            settings.stream_readers_of_one,
        )
        self._presence = Presence()
        self._told: list[Finding] = []
        self._trouble = TroubleWatch(settings.trouble_after)
        self._learning = LearningLink(self.keys, self._ask_once)
        self._erasures = ErasureBoard(area.id for area in site.areas)
        published = bus.publisher(self.keys.zones(), ZoneSet, cached=True)
        self._admin = Administration.open(settings, site, self._live, published, self._pseudonyms, own.of("books"))
        self._setup = SetupNews(
            settings.site_file, site, bus.publisher(self.keys.setup(), SetupTold, cached=True), health, self._set_up
        )
        self._loop: asyncio.AbstractEventLoop | None = None
        self._connected = bus.connected
        self._inbox = bus.inbox(capacity=10_000)
        self._strangers: set[str] = set()

    @classmethod
    def check(cls, settings: ApiSettings, site: Site) -> None:
        """Refuse keys that anybody could guess, outside the demo.

        Raises:
            SettingsError: the demo key, or one that is too short, is among the keys.
        """
        if settings.profile == "demo":
            return
        for key in settings.keys:
            secret = key.key.get_secret_value()
            weak = "is the demo's" if secret == DEMO_KEY else why_weak(secret, SHORTEST_KEY)
            if weak is not None:
                raise SettingsError(
                    f"api_keys: key {key.name!r} {weak}; "
                    "set ATRIUM_API_KEYS and ATRIUM_DASHBOARD_KEY to secrets of your own (openssl rand -hex 24)"
                )

    def run(self) -> None:
        """Serve until asked to stop."""
        inbox = self._inbox
        inbox.subscribe(self.keys.tracks(), TrackFrame, newest=True)
        inbox.subscribe(self.keys.revisions(), Revision)
        inbox.subscribe(self.keys.alert(), Alert, cached=True)
        inbox.subscribe(self.keys.occupancy(), Occupancy, newest=True)
        inbox.subscribe(self.keys.erasure(), Erasure, cached=True)
        inbox.subscribe(self.keys.erased(), ErasureDone, cached=True)
        inbox.subscribe(self.keys.camera_status(), CameraStatus, cached=True)
        app = create_app(
            self.settings,
            self.site,
            self._live,
            self._hub,
            self._health_report,
            self._learning,
            HistoryLink(self.keys, self._ask_once),
            self._erasures,
            self._admin,
            self._alerts,
            self._lifespan,
            self._ask_once,
            lambda key, timeout: list(self.bus.ask(key, timeout)),
            self._setup.look,
        )
        settings = self.settings
        serve(
            app,
            settings.api_host,
            settings.api_port,
            self.stopping,
            proxies=settings.api_proxies,
            stalled_after=2.0 * settings.stream_patience,
        )
        self._alerts.close()

    def stop(self) -> None:
        """Stop, and do not wait for a message that may not come."""
        super().stop()
        self._inbox.wake()

    @asynccontextmanager
    async def _lifespan(self, _: FastAPI) -> AsyncIterator[None]:
        """Feed the state from the bus for as long as HTTP is served."""
        loop = self._loop = asyncio.get_running_loop()
        threads = [
            threading.Thread(target=work, args=(loop,), name=name, daemon=True)
            for name, work in (
                ("bus", self._read_bus),
                ("presence", self._watch),
                ("books", self._keep_books),
                ("set-up", self._watch_setup),
            )
        ]
        threads += self._alerts.threads(self.stopping)
        for thread in threads:
            thread.start()
        self.health.ready.set()
        yield
        for thread in threads:
            await asyncio.to_thread(thread.join, 1.0)
        last = threading.Thread(target=self._keep, name="last books", daemon=True)
        last.start()
        await asyncio.to_thread(last.join, 1.0)

    def _read_bus(self, loop: asyncio.AbstractEventLoop) -> None:
        while not self.stopping.is_set():
            deliveries = self._inbox.receive(timeout=0.5)
            if deliveries:
                loop.call_soon_threadsafe(self._take, deliveries)
        # Streams never end by themselves: the server would wait for them in vain.
        loop.call_soon_threadsafe(self._hub.close)

    def _watch(self, loop: asyncio.AbstractEventLoop) -> None:
        """Look once a second who is alive and whether tracks still come."""
        while not self.stopping.wait(1.0):
            connected = self.bus.connected
            alive = self.bus.present(self.keys.alive()) if connected else []
            told = self._ask_health() if connected else []
            loop.call_soon_threadsafe(self._note, connected, alive, told)

    def _keep_books(self, loop: asyncio.AbstractEventLoop) -> None:
        """Write down once a second who looked whom up; a database that hangs holds up nothing else."""
        while not self.stopping.wait(1.0):
            self._keep()
            asyncio.run_coroutine_threadsafe(self._admin.follow_zones(), loop)

    def _watch_setup(self, _: asyncio.AbstractEventLoop) -> None:
        """Tell what is set up, at once and, should it be changed by hand, within a second."""
        self._setup.look()
        while not self.stopping.wait(1.0):
            self._setup.look()

    def _set_up(self, site: Site) -> None:
        """Let the map show what is set up now; called in any thread."""
        if self._loop is not None:
            asyncio.run_coroutine_threadsafe(self._admin.set_up(site), self._loop)

    def _keep(self) -> None:
        """Write down what waits, and say so when that cannot be."""
        self._alerts.keep(self._hub.log.newest)
        reason = self._admin.keep()
        if reason is None:
            self.health.well("database")
        else:
            self.health.degraded("database", f"{reason}: nothing can be changed, and nobody looked up for long")

    def _ask_once(self, key: str, timeout: float, payload: bytes | None) -> bytes | None:
        """The first answer to a query, None if nobody answers."""
        return next((answer for _, answer in self.bus.ask(key, timeout, payload)), None)

    def _ask_health(self) -> list[Finding]:
        """What other services find wrong; of cameras their status tells it already."""
        told = []
        for key, answer in self.bus.ask(self.keys.health(), timeout=1.0):
            service, instance = key.split("/")[-2:]
            if service in (self.name, "camera"):
                continue
            try:
                problems = msgspec.json.decode(answer, type=dict[str, str])
            except msgspec.MsgspecError:
                continue
            told += [Finding(service, instance, topic, f"{service}: {words}") for topic, words in problems.items()]
        return sorted(told, key=lambda one: (one.words, one.key))

    def _note(self, connected: bool, alive: list[str], told: list[Finding]) -> None:
        now = time.time()
        self._connected, self._told = connected, told
        if connected:
            self._presence.seen(alive)
        self._live.forget(now)
        for area in self._live.areas(now):
            if area.age is not None and area.age > self.settings.stale_after:
                self.health.degraded(f"tracks of {area.area}", "tracks have stopped arriving, positions are ageing")
            elif area.age is not None:
                self.health.well(f"tracks of {area.area}")
        for trouble in self._trouble.take(now, self._wrong(now), connected=connected):
            self._hub.send(trouble.kind, trouble.id, trouble)
            self._alerts.tell_trouble(trouble)

    def _take(self, deliveries: list[Delivery[Message]]) -> None:
        for delivery in deliveries:
            message = delivery.message
            if isinstance(message, TrackFrame):
                if self._live.take_tracks(message, delivery.trace.origin):
                    self._hub.tracks(*self._live.newest(message.area))
                else:
                    self._tell_once(f"tracks of area {message.area}")
            elif isinstance(message, Alert):
                told = self._live.erased.from_alert(message)
                if self._alerts.desk.is_new(told):
                    event = self._hub.send("alert", told.id, told, told.area, told.zone)
                    self._alerts.desk.write_down(Told(told, delivery.trace.sent, event))
            elif isinstance(message, Revision):
                told_anew = self._live.erased.from_revision(message)
                if told_anew.device:
                    self._hub.send("revision", message.area, told_anew, message.area)
            elif isinstance(message, Occupancy):
                self._live.take_blind(message.blind)
                self._hub.send("occupancy", "", message)
            elif isinstance(message, ErasureDone):
                self._erasures.take(message)
            elif isinstance(message, Erasure):
                self._erasures.take(message)
                self._pseudonyms.add(message.device)
                self._live.erase(message.device)
                self._learning.forget()
                self._hub.erase(message.device)
                self._alerts.desk.erase(message.device)
                self._admin.erase(message.device)
            elif isinstance(message, CameraStatus):
                now = time.time()
                if self._live.take_status(message, now):
                    report = self._live.camera(message.camera, now)
                    self._hub.send("camera", report.camera, report, report.area)
                else:
                    self._tell_once(f"status of camera {message.camera}")

    def _tell_of_alerts(self, reason: str | None) -> None:
        if reason is None:
            self.health.well("alerts")
        else:
            self.health.degraded("alerts", f"alerts are told but not written down: {reason}")

    def _tell_once(self, what: str) -> None:
        """Log what is left out, once each; bounded, because names come from outside."""
        if what not in self._strangers and len(self._strangers) < 100:
            self._strangers.add(what)
            log.warning("left out: older than what is known, or not in the site file", what=what)

    def _wrong(self, now: float) -> list[Finding]:
        return find_wrong(
            connected=self._connected,
            services=self._presence.services(),
            areas=self._live.areas(now),
            cameras=self._live.cameras(now),
            expected=self.settings.expected_of(self.site),
            stale_after=self.settings.stale_after,
            unwatched=[area.id for area in self.site.areas if not self.site.cameras_of(area.id)],
            told=self._told,
        )

    def _health_report(self, now: float) -> HealthReport:
        return health_report(
            now,
            self._wrong(now),
            services=self._presence.services(),
            areas=self._live.areas(now),
            cameras=self._live.cameras(now),
        )
