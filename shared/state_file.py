"""Where a service keeps its state across restarts: one file, swapped whole, written beside the running work."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

from shared.runner import Health

__all__ = ["StateFile", "write_whole"]

Snapshot = Callable[[], tuple[int, Callable[[], bytes]]]
"""Copies the state; returns a number that says of when it is and what encodes the copy, in any thread."""


class StateFile:
    """The saved state of one service.

    Args:
        file: where it lies; None keeps nothing.
        every: seconds between two saved states.
        snapshot: takes the state.
        health: told when it cannot be saved.
        what: whose state it is, in the operator's words.
        loss: what a restart would then cost, in the operator's words.
    """

    def __init__(
        self, file: Path | None, every: float, snapshot: Snapshot, health: Health, *, what: str, loss: str
    ) -> None:
        self._file = file
        self._every = every
        self._snapshot = snapshot
        self._health = health
        self._what = what
        self._loss = loss
        self._saved_at, self._saved = time.monotonic(), -1
        self._saving: threading.Thread | None = None
        self._soon = False

    def read(self) -> bytes | None:
        """Return what was saved last; None where nothing was.

        Raises:
            OSError: the file cannot be read.
        """
        if self._file is None or not self._file.is_file():
            return None
        return self._file.read_bytes()

    def restored(self, moment: int) -> None:
        """Note that what was read is in use."""
        self._saved = moment

    def holds(self, moment: int) -> bool:
        """Whether what is saved is of this moment or later; always where nothing is kept."""
        return self._file is None or self._saved >= moment

    def save_soon(self) -> None:
        """Do not wait for the time: what was saved holds what must be gone."""
        self._soon = True

    def save_if_due(self, moment: int) -> None:
        """Save the state when it is time and anything happened, without waiting; not while it is still being saved."""
        if self._soon or time.monotonic() - self._saved_at >= self._every:
            self._save(moment)

    def save_last(self, moment: int) -> None:
        """Save the state before the process ends."""
        if self._saving:
            self._saving.join()
        self._save(moment)
        if self._saving:
            self._saving.join()

    def _save(self, moment: int) -> None:
        if self._saving and self._saving.is_alive():
            return
        self._saved_at, self._soon = time.monotonic(), False
        if self._file is None or moment == self._saved:
            return
        taken, encode = self._snapshot()
        arguments = (self._file, taken, encode)
        self._saving = threading.Thread(target=self._write, args=arguments, name="saving", daemon=True)
        self._saving.start()

    def _write(self, file: Path, moment: int, encode: Callable[[], bytes]) -> None:
        try:
            write_whole(file, encode())
        except OSError as error:
            self._health.degraded(
                "state",
                f"cannot save {self._what} to {file}: {error.strerror}; after a restart {self._loss}: "
                "make room, or let the service write there",
            )
            return
        self._saved = moment
        self._health.well("state")


def write_whole(file: Path, data: bytes) -> None:
    """Write a file beside the old one and swap them, so that a kill or a power cut leaves one whole.

    Raises:
        OSError: it cannot be written.
    """
    partial = file.with_suffix(".partial")
    file.parent.mkdir(parents=True, exist_ok=True)
    with partial.open("wb") as stream:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())
    partial.replace(file)
