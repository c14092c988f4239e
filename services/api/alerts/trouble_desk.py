"""Between what is found wrong and the database: trouble waits in memory until it is written down for webhooks."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

import structlog
from sqlalchemy.exc import SQLAlchemyError

from services.api.trouble import Trouble

__all__ = ["TroubleDesk"]

log = structlog.get_logger(__name__)

WAITING = 1000
"""The newest that wait while the database is away."""
PATIENCE = 1.0
"""Seconds between two attempts to write."""


class TroubleDesk:
    """Takes trouble in, in any thread; ``run`` writes it down in one of its own.

    Args:
        write: writes down whom trouble is sent to; may raise SQLAlchemyError.
        written: called after that.
    """

    def __init__(self, write: Callable[[Trouble], None], written: Callable[[], None]) -> None:
        self._write, self._written = write, written
        self._waiting: deque[Trouble] = deque(maxlen=WAITING)
        self._something = threading.Event()

    def tell(self, trouble: Trouble) -> None:
        """Have it sent."""
        self._waiting.append(trouble)
        self._something.set()

    def run(self, stopping: threading.Event) -> None:
        """Write what comes until asked to stop."""
        while not stopping.is_set():
            self._something.wait(0.5)
            self._something.clear()
            while self._waiting and not stopping.is_set():
                trouble = self._waiting.popleft()
                try:
                    self._write(trouble)
                except SQLAlchemyError as error:
                    log.warning("trouble is not written down yet", reason=type(error).__name__)
                    self._waiting.appendleft(trouble)
                    stopping.wait(PATIENCE)
                else:
                    self._written()
