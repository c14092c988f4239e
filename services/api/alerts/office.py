"""Everything of alerts in one place: inbox, webhooks, their routes and their threads, on one database."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterable

from fastapi import APIRouter
from sqlalchemy.exc import SQLAlchemyError

from services.api.alerts.alert_desk import AlertDesk
from services.api.alerts.alert_routes import alert_routes
from services.api.alerts.database import SCHEMA, migrate, open_alerts
from services.api.alerts.event_numbers import EventNumbers
from services.api.alerts.host_lookup import HostLookup
from services.api.alerts.inbox import AlertInbox
from services.api.alerts.past_alerts import PastAlerts
from services.api.alerts.webhook_routes import webhook_routes
from services.api.alerts.webhook_sender import Patience, WebhookSender
from services.api.alerts.webhook_store import WebhookStore
from services.api.settings import ApiSettings
from services.api.stream import Hub
from shared.runner import ServiceError
from shared.site import Site

__all__ = ["AlertOffice"]

DAY = 86400.0
LOOKED_UP_BY_STAFF = 8
"""Names of hosts at once, of webhooks that are being made; what is sent looks up its own."""


class AlertOffice:
    """What the API does with alerts beside telling them at once.

    Args:
        settings: of the service.
        site: whose alerts.
        told: called with None when the database takes what it is given, else with why not.
        erased: called with a device that is out of all alerts.
        without: returns a text without the ids of erased devices.

    Raises:
        ServiceError: the database cannot be used.
    """

    def __init__(
        self,
        settings: ApiSettings,
        site: Site,
        told: Callable[[str | None], None],
        erased: Callable[[str], None],
        without: Callable[[str], str] = str,
    ) -> None:
        url = settings.api_database_url.get_secret_value()
        if settings.profile == "demo":
            migrate(url)
        self._site = site
        self._engine = open_alerts(url)
        problem = SCHEMA.problem(self._engine)
        if problem is not None:
            raise ServiceError(problem)
        self._numbers = EventNumbers(self._engine, time.time())
        self._allowed = settings.webhook_networks
        self._webhooks = WebhookStore(
            self._engine, settings.webhooks_most, settings.webhook_waiting, settings.webhook_dead_days * DAY
        )
        self._inbox = AlertInbox(self._engine, settings.alerts_kept, settings.alert_days * DAY, self._webhooks.enqueue)
        patience = Patience(
            settings.webhook_timeout,
            settings.webhook_attempts,
            settings.webhook_first_pause,
            settings.webhook_longest_pause,
        )
        lookup = HostLookup(settings.webhooks_most + 1)
        self._sender = WebhookSender(self._webhooks, site.site, patience, self._allowed, lookup)
        self.desk = AlertDesk(self._engine, self._inbox, told, self._sender.wake, erased, without)
        self.desk.remember()

    @property
    def first_event(self) -> int:
        """The id of the first event of this process."""
        return self._numbers.first

    def keep(self, newest: int) -> None:
        """Have ids of events in reserve, ``newest`` having been told; called about once a second, in any thread."""
        with contextlib.suppress(SQLAlchemyError):  # it says elsewhere that the database is away, and half are left
            self._numbers.keep(newest)

    @property
    def past(self) -> PastAlerts:
        """What was told before the log of events begins."""
        return PastAlerts(self._engine, self._inbox)

    def routers(self, hub: Hub, zones: Callable[[], Iterable[str]]) -> list[APIRouter]:
        """Return the routes of alerts and webhooks; ``zones``: the ids of those that hold now."""
        return [
            alert_routes(self._site, zones, self._engine, self._inbox, hub),
            webhook_routes(
                self._engine, self._webhooks, self._sender.wake, self._allowed, HostLookup(LOOKED_UP_BY_STAFF)
            ),
        ]

    def threads(self, stopping: threading.Event) -> list[threading.Thread]:
        """Return the threads that write and send until ``stopping`` is set, not yet started."""
        return [
            threading.Thread(target=work, args=(stopping,), name=name, daemon=True)
            for name, work in (("alerts", self.desk.run), ("webhooks", self._sender.run))
        ]

    def close(self) -> None:
        """Leave the database."""
        self._engine.dispose()
