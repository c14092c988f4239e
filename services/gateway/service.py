"""The gateway as a process: HTTP on one side, the bus on the other."""

from __future__ import annotations

import threading
import time
from typing import ClassVar

from services.gateway.devices.own_position import OwnPositions
from services.gateway.devices.storage import DeviceStore, migrate, open_engine, schema_problem
from services.gateway.phones.phone_book import PhoneBook
from services.gateway.settings import GatewaySettings
from services.gateway.web.app import Gateway, create_app
from shared.http_server import serve
from shared.messages import TrackFrame
from shared.runner import Service, ServiceError
from shared.settings import ServiceSettings

__all__ = ["GatewayService"]


class GatewayService(Service[GatewaySettings]):
    """Takes the batches of phones, publishes RadioScan and MotionBatch, tells phones where they are."""

    name: ClassVar[str] = "gateway"
    Settings: ClassVar[type[ServiceSettings]] = GatewaySettings

    def run(self) -> None:
        """Serve phones until asked to stop.

        Raises:
            ServiceError: the database cannot be used, or the port is taken.
        """
        settings = self.settings
        url = settings.database_url.get_secret_value()
        if settings.profile == "demo":
            migrate(url)
        engine = open_engine(url)
        problem = schema_problem(engine)
        if problem is not None:
            raise ServiceError(problem)
        phones = PhoneBook(self.site, self.bus, settings.limits(), settings.phone_idle)
        positions = OwnPositions(settings.position_kept)
        inbox = self.bus.inbox(1000)
        inbox.subscribe(self.keys.tracks(), TrackFrame, newest=True)
        threads = [
            threading.Thread(target=positions.follow, args=(inbox, self.stopping), name="positions", daemon=True),
            threading.Thread(target=self._rest, args=(phones,), name="rest", daemon=True),
        ]
        for thread in threads:
            thread.start()
        gateway = Gateway(settings, self.site.site, DeviceStore(engine), phones, positions, self.health.ready.set)
        try:
            serve(create_app(gateway), settings.gateway_host, settings.gateway_port, self.stopping)
        finally:
            self.stopping.set()
            inbox.wake()
            for thread in threads:
                thread.join(timeout=1.0)
            engine.dispose()

    def _rest(self, phones: PhoneBook) -> None:
        while not self.stopping.wait(min(30.0, self.settings.phone_idle)):
            phones.rest(time.monotonic())
