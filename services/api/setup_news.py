"""Tells the bus what is set up beside the site file, at the start and whenever that file is another one."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

from shared.bus import Publisher
from shared.part_file import PartFileError
from shared.runner import Health
from shared.setup_told import FollowedSite, SetupTold
from shared.site import Site
from shared.site.setup_file import SetUp, read_setup, setup_path

__all__ = ["SetupNews"]


class SetupNews:
    """Looks after the file; ``look`` may be called from any thread.

    Args:
        site_file: beside it the set-up lies.
        site: as this process read it at its start.
        publisher: of what is told to all.
        health: is told of a file that cannot be used.
        changed: called with the site as it is set up now, in the thread that looks.
    """

    def __init__(
        self,
        site_file: Path,
        site: Site,
        publisher: Publisher[SetupTold],
        health: Health,
        changed: Callable[[Site], None],
    ) -> None:
        self._file = site_file
        self._publisher = publisher
        self._health = health
        self._changed = changed
        self._followed = FollowedSite(site_file, site, health)
        self._known: tuple[int, int] | None = None
        self._lock = threading.Lock()

    def look(self) -> None:
        """Tell what is set up, if the file is not the one that was told last; cheap where it is."""
        with self._lock:
            stamp = self._stamp()
            if stamp == self._known:
                return
            self._known = stamp
            try:
                setup = read_setup(self._file) or SetUp(site=self._followed.site.site)
            except PartFileError as error:
                self._health.degraded("set-up", f"{error}; what was set up before goes on")
                return
            told = SetupTold(t=time.time(), version=setup.version, setup=setup.model_dump_json())
            if self._followed.take(told):
                self._changed(self._followed.site)
            self._publisher.publish(told)

    def _stamp(self) -> tuple[int, int]:
        try:
            status = setup_path(self._file).stat()
        except OSError:
            return 0, 0
        return status.st_mtime_ns, status.st_ino
