"""One rule for all that learning sends to a camera: versions only grow."""

from __future__ import annotations

import structlog

__all__ = ["LearnedVersion"]

log = structlog.get_logger(__name__)


class LearnedVersion:
    """Which version of something learned is in use.

    Args:
        what: its name, in the log.
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self.used = 0
        """0: as configured, or not known yet."""
        self._told = False

    def is_newer_than(self, version: int) -> bool:
        """Return whether what is in use is newer than ``version``; the log tells of that once per version in use."""
        if version >= self.used:
            return False
        if not self._told:
            self._told = True
            log.warning(
                "older than what is in use and left out: if learning's database was lost, restart the camera",
                what=self._what,
                version=version,
                used=self.used,
            )
        return True

    def use(self, version: int) -> None:
        """Note which version is in use from now on."""
        if version != self.used:
            self._told = False
        self.used = version
