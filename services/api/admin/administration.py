"""What the API keeps itself, as one thing: opened at the start, asked by the routes."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import msgspec
import structlog
from fastapi import APIRouter
from sqlalchemy import Engine
from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool

from services.api.admin.account_routes import account_routes
from services.api.admin.accounts import Accounts
from services.api.admin.audit_log import AuditLog
from services.api.admin.audit_route import audit_route
from services.api.admin.catalogue import Catalogue, Entry
from services.api.admin.catalogue_routes import Answers, catalogue_routes
from services.api.admin.database import migrate, open_admin
from services.api.admin.exhibits import MOST_EXHIBITS, ExhibitDefinition, exhibits_of
from services.api.admin.in_front_route import in_front_route
from services.api.admin.replies import Exhibit, Exhibits
from services.api.admin.session_routes import session_routes
from services.api.admin.shapes import EXHIBIT, ZONE
from services.api.admin.zone_check import MOST_ZONES, check_all
from services.api.live_state import LiveState
from services.api.problems import ProblemError, unknown
from services.api.pseudonyms import Pseudonyms
from services.api.replies import ZoneReport, Zones
from services.api.settings import ApiSettings
from services.api.site_view import site_view, zone_view
from services.api.viewing_places import viewing_places
from services.api.zones_drawn import ZonesDrawn, zones_of
from shared.bus import Publisher
from shared.database import unreachable
from shared.site import Site
from shared.zones import ZoneDefinition, ZoneSet

__all__ = ["Administration", "admin_routes"]

log = structlog.get_logger(__name__)


class Administration:
    """Zones and exhibits of one site, who may come in, and who did what.

    Args:
        settings: how long sign-ins and the audit log last.
        site: where its zones begin.
        engine: the database, its tables up to date.
        live: counts who is in the zones.
        published: tells others of the zones once they are not the site file's any more.
        pseudonyms: of erased devices.
        erased: called with a device of which nothing is kept here any more.

    Raises:
        ServiceError: the database cannot be read.
    """

    def __init__(
        self,
        settings: ApiSettings,
        site: Site,
        engine: Engine,
        live: LiveState,
        published: Publisher[ZoneSet] | None,
        pseudonyms: Pseudonyms,
        erased: Callable[[str], None],
    ) -> None:
        self.settings = settings
        self.site = site
        self.engine = engine
        self.live = live
        self._published = published
        self._pseudonyms = pseudonyms
        self._tell_erased = erased
        self.zones = Catalogue(
            engine, "zone", ZoneDefinition, zones_of(site), MOST_ZONES, self._publish, self._clean, check_all
        )
        self.exhibits = Catalogue(engine, "exhibit", ExhibitDefinition, exhibits_of(site), MOST_EXHIBITS)
        self.accounts = Accounts(engine, settings.session_hours, settings.session_rate)
        self.audit = AuditLog(engine, settings.audit_days, pseudonyms)
        self._erased: deque[str] = deque()
        self._view = site_view(site, [])
        self._drawing = asyncio.Lock()
        self._drawn = self.zones.version
        drawn, site_json = self._draw_zones()
        live.draw(drawn)
        self.site_json = site_json
        """The ready body of ``GET /v1/site``."""
        self.exhibits_json = self._list_exhibits()
        """The ready body of ``GET /v1/exhibits``."""

    @classmethod
    def open(
        cls,
        settings: ApiSettings,
        site: Site,
        live: LiveState,
        published: Publisher[ZoneSet] | None = None,
        pseudonyms: Pseudonyms | None = None,
        erased: Callable[[str], None] = lambda _: None,
    ) -> Administration:
        """Open the database and take in what it holds; in the demo bring its tables up to date before.

        Raises:
            ServiceError: it cannot be opened or read.
        """
        url = settings.api_database_url.get_secret_value()
        if settings.profile == "demo":
            migrate(url)
        return cls(settings, site, open_admin(url), live, published, pseudonyms or Pseudonyms(), erased)

    async def set_up(self, site: Site) -> None:
        """Let the map show cameras and access points as set up now; in the event loop."""
        self._view = site_view(site, [])
        await self.redraw()

    async def redraw(self) -> None:
        """Let the map and the counts follow the zones; in the event loop, which does not wait while they are drawn."""
        async with self._drawing:  # in turn: of two changes the later stays
            version = self.zones.version
            drawn, self.site_json = await run_in_threadpool(self._draw_zones)
            self.live.draw(drawn)
            self._drawn = version

    async def relist(self) -> None:
        """Let the list of exhibits follow them; in the event loop."""
        async with self._drawing:
            self.exhibits_json = await run_in_threadpool(self._list_exhibits)

    def _draw_zones(self) -> tuple[ZonesDrawn, bytes]:
        entries = list(self.zones.entries.values())
        drawn = ZonesDrawn([entry.definition for entry in entries], [entry.etag for entry in entries])
        zones = [zone_view(entry.definition) for entry in entries]
        return drawn, msgspec.json.encode(msgspec.structs.replace(self._view, zones=zones))

    def _list_exhibits(self) -> bytes:
        exhibits = [_exhibit(entry) for entry in self.exhibits.entries.values()]
        return msgspec.json.encode(Exhibits(t=time.time(), exhibits=exhibits))

    def viewing_places(self) -> list[ZoneDefinition]:
        """Return where people stand who look at the exhibits, an area for each: what dwell at exhibits is asked of."""
        exhibits = self.exhibits.definitions
        return [place for floor in self.site.floors for place in viewing_places(exhibits, floor.id, floor.plan())]

    def erase(self, device: str) -> None:
        """Forget, at the next ``keep``, a device whose owner withdrew consent: look-ups and rules name it no more."""
        self._erased.append(device)

    def keep(self) -> str | None:
        """Write down what waits; called about once a second, not in the event loop. Return why it cannot be."""
        erased = list(self._erased)
        try:
            if erased:
                self.zones.clean()
                self.audit.erase(erased)
            self.audit.keep()
            self.accounts.keep()
        except SQLAlchemyError as error:
            return unreachable(self.engine, error)
        except ProblemError as error:
            return error.problem.detail
        if self._drawn != self.zones.version:
            return None  # told with the next turn, when the map no longer shows them
        for device in erased:
            self._erased.popleft()
            self._tell_erased(device)
        return None

    async def follow_zones(self) -> None:
        """Draw the zones anew where they changed by themselves; in the event loop."""
        if self._drawn != self.zones.version:
            await self.redraw()

    def _clean(self, zone: ZoneDefinition) -> ZoneDefinition:
        """Return a zone whose rules name no erased device: they go on to be about one phone, that nobody has."""
        of = self._pseudonyms.of
        rules = [
            msgspec.structs.replace(rule, target=of(rule.target), devices=[of(device) for device in rule.devices])
            for rule in zone.rules
        ]
        return zone if rules == zone.rules else msgspec.structs.replace(zone, rules=rules)

    def _publish(self, version: int, zones: list[ZoneDefinition]) -> None:
        if self._published is not None:
            self._published.publish(ZoneSet(t=time.time(), version=version, zones=zones))
        log.info("zones as staff drew them", version=version, zones=len(zones))


def admin_routes(admin: Administration) -> APIRouter:
    """Return every route over what the API keeps itself."""
    router = APIRouter()

    def zone(entry: Entry[ZoneDefinition]) -> ZoneReport:
        try:
            return admin.live.zone(entry.definition.id, time.time())
        except KeyError:  # taken out again by somebody else meanwhile
            raise unknown("zone", entry.definition.id) from None

    zones = Answers(ZoneReport, Zones, zone, lambda: admin.live.zones_json(time.time()))
    exhibits = Answers(Exhibit, Exhibits, _exhibit, lambda: admin.exhibits_json)
    router.include_router(catalogue_routes(admin.site, ZONE, admin.zones, zones, admin.redraw))
    router.include_router(catalogue_routes(admin.site, EXHIBIT, admin.exhibits, exhibits, admin.relist))
    router.include_router(account_routes(admin.accounts, admin.settings.key_rate))
    router.include_router(session_routes(admin.accounts, admin.settings.trusted_key))
    router.include_router(audit_route(admin.audit, admin.engine))
    router.include_router(in_front_route(admin.site, admin.live, admin.exhibits))
    return router


def _exhibit(entry: Entry[Any]) -> Exhibit:
    return Exhibit(**msgspec.structs.asdict(entry.definition), etag=entry.etag)
