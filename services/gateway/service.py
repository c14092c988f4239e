"""The gateway as a process: HTTP on one side, the bus on the other."""

from __future__ import annotations

import sys
import threading
import time
from typing import ClassVar

import structlog
from sqlalchemy.exc import SQLAlchemyError

from services.gateway.adapters.mqtt_broker import Broker
from services.gateway.adapters.mqtt_receivers import MqttReceivers
from services.gateway.devices.consent import read_consent
from services.gateway.devices.database import migrate, open_engine, schema_problem
from services.gateway.devices.erasures import Erasures
from services.gateway.devices.own_alerts import OwnAlertBook
from services.gateway.devices.own_position import OwnPositions
from services.gateway.devices.storage import DeviceStore
from services.gateway.phones.phone_book import PhoneBook
from services.gateway.phones.receivers import ReceiverBook
from services.gateway.phones.spool import Spool
from services.gateway.settings import GatewaySettings
from services.gateway.web.app import create_app
from services.gateway.web.bodies import OpenBodies
from services.gateway.web.gateway import Gateway
from shared.bus import Inbox
from shared.http_server import Tls, serve
from shared.messages import Alert, TrackFrame
from shared.runner import Service, ServiceError
from shared.settings import ServiceSettings
from shared.zones import ZoneSet

__all__ = ["GatewayService"]

PURGED_EVERY = 3600.0
"""Seconds between two looks for expired tokens."""

SWITCH_INTERVAL = 0.0005
"""Seconds between Python's threads: a request must not wait for other phones' arithmetic. Usual is 0.005."""

log = structlog.get_logger(__name__)


class GatewayService(Service[GatewaySettings]):
    """Takes the batches of phones, publishes RadioScan and MotionBatch, tells phones where they are."""

    name: ClassVar[str] = "gateway"
    Settings: ClassVar[type[ServiceSettings]] = GatewaySettings

    def run(self) -> None:
        """Serve phones until asked to stop.

        Raises:
            ServiceError: the database, the consent text or the certificate cannot be used, or the port is taken.
        """
        sys.setswitchinterval(SWITCH_INTERVAL)
        settings = self.settings
        consent = read_consent(settings.consent_file)
        url = settings.database_url.get_secret_value()
        if settings.profile == "demo":
            migrate(url)
        engine = open_engine(url)
        problem = schema_problem(engine)
        if problem is not None:
            raise ServiceError(problem)
        store = DeviceStore(engine)
        receivers = ReceiverBook(
            self.site,
            self.bus,
            lambda: store.devices_by_digest(time.time()),
            settings.address_key.get_secret_value(),
            settings.live_lateness,
        )
        mqtt = self._mqtt(receivers)
        spool = Spool(engine, settings.spool_bytes)
        phones = PhoneBook(
            self.site,
            self.bus,
            settings.limits(),
            settings.phone_idle,
            spool,
            settings.live_lateness,
            settings.step_detector,
        )
        erasures = Erasures(engine, self.bus, self.keys, phones.forget)
        positions = OwnPositions(self.site.zones, settings.position_kept)
        alerts = OwnAlertBook(self.site.zones, settings.alerts_kept)
        inbox = self.bus.inbox(1000)
        inbox.subscribe(self.keys.tracks(), TrackFrame, newest=True)
        inbox.subscribe(self.keys.alert(), Alert, cached=True)
        inbox.subscribe(self.keys.zones(), ZoneSet, cached=True)
        threads = [
            threading.Thread(target=self._follow, args=(inbox, positions, alerts), name="own data", daemon=True),
            threading.Thread(target=self._rest, args=(phones, store), name="rest", daemon=True),
            threading.Thread(target=erasures.run, args=(self.stopping,), name="erasures", daemon=True),
            threading.Thread(
                target=receivers.run, args=(self.stopping, settings.token_recheck), name="receivers", daemon=True
            ),
        ]
        for thread in threads:
            thread.start()
        gateway = Gateway(
            settings=settings,
            site=self.site.site,
            consent=consent,
            store=store,
            phones=phones,
            receivers=receivers,
            erasures=erasures,
            bodies=OpenBodies(settings.open_bodies, settings.body_seconds),
            positions=positions,
            alerts=alerts,
            bus=self.bus,
            keys=self.keys,
            started=self.health.ready.set,
        )
        tls = None
        if settings.tls_certificate is not None and settings.tls_key is not None:
            tls = Tls(settings.tls_certificate, settings.tls_key)
        try:
            if mqtt is not None:
                mqtt.start()
            serve(
                create_app(gateway),
                settings.gateway_host,
                settings.gateway_port,
                self.stopping,
                tls=tls,
                frame_bytes=settings.batch_bytes,
                proxies=settings.proxy_addresses if settings.behind_proxy else (),
                keep_alive=settings.keep_alive,
                connections=settings.connections,
            )
        finally:
            self.stopping.set()
            if mqtt is not None:
                mqtt.stop()
            inbox.wake()
            for thread in threads:
                thread.join(timeout=1.0)
            phones.close()
            engine.dispose()

    def _mqtt(self, receivers: ReceiverBook) -> MqttReceivers | None:
        """Return the client that listens to receivers over MQTT, None where no broker is set."""
        settings = self.settings
        if settings.mqtt_url is None:
            return None
        broker = Broker.of(settings.mqtt_url.get_secret_value(), settings.mqtt_authorities)
        try:
            return MqttReceivers(broker, settings.mqtt_topics, receivers.take, self._tell_mqtt)
        except OSError as error:
            raise ServiceError(f"mqtt_authorities: {settings.mqtt_authorities}: {error}") from error

    def _tell_mqtt(self, problem: str | None) -> None:
        if problem is None:
            self.health.well("mqtt")
        else:
            self.health.degraded("mqtt", problem)

    def _follow(self, inbox: Inbox, positions: OwnPositions, alerts: OwnAlertBook) -> None:
        """Keep what phones may ask of themselves."""
        while not self.stopping.is_set():
            for delivery in inbox.receive(0.5):
                now = time.monotonic()
                if isinstance(delivery.message, TrackFrame):
                    positions.take(delivery.message, now)
                elif isinstance(delivery.message, Alert):
                    alerts.take(delivery.message, now)
                elif isinstance(delivery.message, ZoneSet):
                    positions.draw(delivery.message.zones)
                    alerts.draw(delivery.message.zones)
            positions.forget_old(time.monotonic())
            alerts.forget_old(time.monotonic())

    def _rest(self, phones: PhoneBook, store: DeviceStore) -> None:
        purged = -PURGED_EVERY
        while not self.stopping.wait(min(30.0, self.settings.phone_idle)):
            now = time.monotonic()
            phones.rest(now)
            problem = phones.heard.problem(now)
            if problem is None:
                self.health.well("access points")
            else:
                self.health.degraded("access points", problem)
            if now - purged >= PURGED_EVERY:
                purged = now
                try:
                    store.purge(time.time())
                except SQLAlchemyError as error:
                    log.warning("expired tokens stay for now", error=str(error).partition("\n")[0])
