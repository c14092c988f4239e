"""The thread between spool and database: files in, oldest first, for as long as the database takes them."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

import structlog
from prometheus_client import Counter, Gauge
from sqlalchemy import Engine
from sqlalchemy.exc import SQLAlchemyError

from services.history.spool import Spool
from services.history.store import Store
from shared.database import unreachable
from shared.runner import Health

__all__ = ["Writer"]

log = structlog.get_logger(__name__)

DATABASE, DISK = "database", "spool"
WRITTEN = Counter("atrium_history_written_total", "Entries that went into the database")
REFUSED = Counter("atrium_history_refused_total", "Entries the database or the spool could not take")
WAITING = Gauge("atrium_history_waiting_bytes", "On disk, not in the database yet")


class Writer:
    """Brings what waits into the database.

    Args:
        spool: where it waits.
        engine: an open database with the tables.
        health: is told of a database that is away.
        forgotten: is told of each device of which nothing is stored any more.
        tidy: done whenever nothing waits; a little work at a time. Raises SQLAlchemyError where the database is away.
    """

    def __init__(
        self,
        spool: Spool,
        engine: Engine,
        health: Health,
        forgotten: Callable[[str], None],
        tidy: Callable[[float], object],
    ) -> None:
        self._spool = spool
        self._engine = engine
        self._store = Store(engine)
        self._health = health
        self._forgotten = forgotten
        self._tidy = tidy
        self._turn = threading.Lock()
        WAITING.set_function(lambda: float(spool.waiting))

    def run(self, every: float, stopping: threading.Event) -> None:
        """Write all that waits every so many seconds until asked to stop; what a thread does."""
        while not stopping.wait(every):
            self.turn(stopping)

    def turn(self, stopping: threading.Event) -> bool:
        """Write all that waits; returns whether nothing does any more."""
        with self._turn:
            try:
                present = self._spool.files()
                for name in present:
                    if stopping.is_set():
                        return False
                    self._bring_in(name, present)
                self._tidy(time.time())
            except SQLAlchemyError as error:
                waits = f"up to {_rounded(self._spool.waiting)} MB wait on disk meanwhile"
                self._health.degraded(DATABASE, f"{unreachable(self._engine, error)}; {waits}")
                return False
            except OSError as error:
                self._health.degraded(DISK, f"what waits for the database cannot be read: {error}")
                return False
            except Exception as error:  # nothing may end the thread that writes
                log.error("history was not written", exc_info=error)
                self._health.degraded(DATABASE, f"not written ({type(error).__name__}); the log says more")
                return False
            self._health.well(DATABASE)
            return True

    def _bring_in(self, name: str, present: list[str]) -> None:
        entries, trouble = self._spool.read(name)
        if trouble:
            log.warning("the end of a file of the spool is left out", file=name, reason=trouble, kept=len(entries))
            REFUSED.inc()
        done = self._store.apply(name, entries, present)
        for words in done.refused[:10]:
            log.warning("an entry is left out: the database does not take it", reason=words)
        self._spool.remove(name)
        WRITTEN.inc(done.entries)
        REFUSED.inc(len(done.refused))
        for device in done.forgotten:
            self._forgotten(device)


def _rounded(size: int) -> int:
    """Megabytes, up to the next power of two: words that change with every byte would fill the log."""
    return 1 << max(math.ceil(math.log2(max(size, 1) / 1e6)), 0)
