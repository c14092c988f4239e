"""What is set up in the browser, as the API tells it on the bus, and the site of a process that follows it.

The file beside the site file is the truth (``shared.site.setup_file``) and is read at every start. The API looks after
it and tells everybody what it says now, so that a running process takes it up.
"""

from __future__ import annotations

from pathlib import Path

import structlog
from pydantic import ValidationError

from shared.messages import Message
from shared.runner import Health
from shared.site import Site, SiteError
from shared.site.setup_file import SetUp
from shared.site.site_loading import file_alone, laid_over

__all__ = ["FollowedSite", "SetupTold"]

log = structlog.get_logger(__name__)

TOPIC = "set-up"


class SetupTold(Message, frozen=True, kw_only=True):
    """What is set up, from the API; ``t``: when it was read."""

    version: int
    setup: str
    """``shared.site.setup_file.SetUp`` in JSON."""


class FollowedSite:
    """The site of one process: as at its start, then as it is told to be set up.

    Args:
        site_file: over which the set-up goes.
        site: as read at the start.
        health: is told of a set-up that cannot be used.

    Attributes:
        site: as it is now.
    """

    def __init__(self, site_file: Path, site: Site, health: Health) -> None:
        self._file = site_file
        self._health = health
        self._alone: Site | None = None
        self.site = site

    def take(self, told: SetupTold) -> bool:
        """Take in what is told; whether the site is another one now. What does not fit changes nothing and is told."""
        try:
            self._alone = self._alone or file_alone(self._file)
            site = laid_over(self._alone, SetUp.model_validate_json(told.setup), self._file)
        except (SiteError, ValidationError) as error:
            words = (
                f"version {told.version} of what is set up in the browser cannot be used here, the one before goes on"
            )
            self._health.degraded(TOPIC, f"{words}: {error}")
            return False
        self._health.well(TOPIC)
        if site == self.site:
            return False
        log.info("set up anew", version=told.version)
        self.site = site
        return True
