"""Between the bus and the database: alerts are told at once, and written by a thread that the bus never waits for.

While the database is away alerts wait in memory, up to a bound; those that come after that are told, not written, and
counted. A withdrawn consent always finds room, and is obeyed in its turn: what was written before it, it reaches.
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable

import structlog
from prometheus_client import Counter
from sqlalchemy import Engine
from sqlalchemy.exc import SQLAlchemyError

from services.api.alerts.inbox import AlertInbox, Told
from services.api.alerts.tables import LONGEST_ID
from shared.database import unreachable
from shared.keys import is_identifier
from shared.messages import Alert

__all__ = ["AlertDesk"]

log = structlog.get_logger(__name__)

LOST = Counter("atrium_alerts_lost_total", "Alerts never written down: the database was away for too long")

WAITING = 100_000
"""Alerts and erasures that wait for the database."""
REMEMBERED = 100_000
"""Ids by which an alert that is told again is known."""
PATIENCE = 1.0
"""Seconds between two attempts to write."""
FORGET_EVERY = 600.0
BATCH = 500

_Item = Told | str
"""An alert that was told, or a device to be erased."""


class AlertDesk:
    """Takes alerts in, in the event loop; ``run`` writes them down, in a thread of its own.

    Args:
        engine: the database.
        inbox: where alerts go.
        told: called with None when the database takes what it is given, else with why not.
        written: called after alerts were written.
        erased: called with a device that is out of all alerts.
        without: returns a text without the ids of erased devices.
    """

    def __init__(
        self,
        engine: Engine,
        inbox: AlertInbox,
        told: Callable[[str | None], None],
        written: Callable[[], None],
        erased: Callable[[str], None],
        without: Callable[[str], str] = str,
    ) -> None:
        self._engine = engine
        self._inbox = inbox
        self._told = told
        self._written = written
        self._erased = erased
        self._without = without
        self._known: OrderedDict[str, None] = OrderedDict()
        self._waiting: deque[_Item] = deque()
        """In order."""
        self._lock = threading.Lock()
        self._something = threading.Event()

    def remember(self) -> None:
        """Learn which alerts are written already: caches of the bus tell them again."""
        for name in self._inbox.newest_ids(REMEMBERED):
            self._known[name] = None

    def is_new(self, alert: Alert) -> bool:
        """Whether an alert is to be told and written: not a second time, nor where it holds what none may."""
        if alert.id in self._known or not _sound(alert):
            return False
        self._known[alert.id] = None
        if len(self._known) > REMEMBERED:
            self._known.popitem(last=False)
        return True

    def write_down(self, told: Told) -> None:
        """Have an alert written that was told."""
        self._put(told)

    def erase(self, device: str) -> None:
        """Take a device out of all alerts that came before."""
        self._put(device)

    def run(self, stopping: threading.Event) -> None:
        """Write what comes until asked to stop; what waits then is tried once more."""
        forget_at = 0.0
        while not stopping.is_set():
            self._something.wait(0.5)
            try:
                self.write()
                if time.monotonic() >= forget_at:
                    self._inbox.forget(time.time())
                    forget_at = time.monotonic() + FORGET_EVERY
            except SQLAlchemyError as error:
                self._told(unreachable(self._engine, error))
                stopping.wait(PATIENCE)
            else:
                self._told(None)
        try:
            self.write()
        except SQLAlchemyError as error:
            LOST.inc(sum(not isinstance(item, str) for item in self._waiting))
            log.error("alerts that came last are not written down", reason=unreachable(self._engine, error))

    def write(self) -> None:
        """Write all that waits.

        Raises:
            SQLAlchemyError: the database is away; what was not written waits on.
        """
        self._something.clear()
        while batch := self._batch():
            try:
                self._inbox.add([item for item in batch if not isinstance(item, str)])
                for device in batch:
                    if isinstance(device, str):
                        self._inbox.erase(device, self._without)
                        self._erased(device)
            except SQLAlchemyError:
                with self._lock:
                    self._waiting.extendleft(reversed(batch))
                raise
            self._written()

    def _put(self, item: _Item) -> None:
        with self._lock:
            if len(self._waiting) >= WAITING and not isinstance(item, str):
                LOST.inc()
                return
            self._waiting.append(item)
        self._something.set()

    def _batch(self) -> list[_Item]:
        """Take what is written next: alerts up to the next erasure, and that."""
        with self._lock:
            batch: list[_Item] = []
            while self._waiting and len(batch) < BATCH:
                batch.append(self._waiting.popleft())
                if isinstance(batch[-1], str):
                    break
            return batch


def _sound(alert: Alert) -> bool:
    names = [alert.zone, alert.area, *(name for name in (alert.device, alert.other_device) if name is not None)]
    return 0 < len(alert.id) <= LONGEST_ID and alert.id.isprintable() and all(map(is_identifier, names))
