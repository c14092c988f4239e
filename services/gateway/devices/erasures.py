"""Whom must everybody forget, and who has not been told yet? Kept in the database, over a restart and a lost bus.

What was told stays told: a subscriber that was down and asks for what it missed (``cached``) is told for ``KEPT`` on,
also by a gateway started anew. So a process that restores a state saved before the withdrawal learns of it.
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable

import structlog
from sqlalchemy import Engine, delete, select

from services.gateway.devices.tables import ErasureRow
from shared.bus import Bus, Publisher
from shared.keys import Keys
from shared.messages import Erasure

__all__ = ["Erasures"]

EVERY = 2.0
"""Seconds between two looks at what waits."""
KEPT = 30.0 * 86400.0
"""Seconds for which whoever joins is told …"""
MOST = 2000
"""… of so many devices, the latest."""

log = structlog.get_logger(__name__)


class Erasures:
    """Tells the bus of withdrawn consents; ``DeviceStore.withdraw`` writes them down. From any thread.

    Args:
        engine: an open database with the tables.
        bus: where erasures go.
        keys: of the site.
        forget: lets this gateway forget a device; called again before each telling, since a restart or a database that
            failed may have left something of it.
    """

    def __init__(self, engine: Engine, bus: Bus, keys: Keys, forget: Callable[[str], None]) -> None:
        self._engine = engine
        self._bus = bus
        self._keys = keys
        self._forget = forget
        self._lock = threading.Lock()
        self._told: OrderedDict[str, Publisher[Erasure]] = OrderedDict()
        """By device, the publisher that tells who joins later."""

    def waiting(self) -> list[str]:
        """Return the devices of which this process has not told the bus, oldest first."""
        with self._engine.connect() as connection:
            rows = connection.scalars(select(ErasureRow.device).order_by(ErasureRow.withdrawn))
            return [device for device in rows if device not in self._told]

    def tell(self) -> None:
        """Tell all that wait, while the bus is there; what fails waits for the next time."""
        if not self._bus.connected:
            return
        try:
            with self._lock:
                for device in self.waiting():
                    self._tell(device)
                self._let_go(time.time() - KEPT)
        except Exception as error:  # the database's or Zenoh's: nothing may end the thread that tells
            log.warning("erasures wait", error=str(error).partition("\n")[0] or type(error).__name__)

    def run(self, stopping: threading.Event) -> None:
        """Tell what waits until asked to stop; what a thread runs."""
        while not stopping.wait(EVERY):
            self.tell()

    def _tell(self, device: str) -> None:
        self._forget(device)
        publisher = self._bus.publisher(self._keys.erasure(device), Erasure, cached=True)
        told = False
        try:
            publisher.publish(Erasure(t=time.time(), device=device))
            told = self._bus.connected  # looked at before and after, as for batches: rather told twice than never
        finally:
            if not told:
                publisher.close()
        if told:
            self._told[device] = publisher

    def _let_go(self, before: float) -> None:
        """Forget who was told of long ago."""
        with self._engine.begin() as connection:
            old = set(connection.scalars(select(ErasureRow.device).where(ErasureRow.withdrawn < before)))
            devices = list(self._told)
            gone = [device for place, device in enumerate(devices) if device in old or place < len(devices) - MOST]
            for device in gone:
                connection.execute(delete(ErasureRow).where(ErasureRow.device == device))
        for device in gone:
            self._told.pop(device).close()
