"""The dashboard as a process: relay, web application and page, for as long as the service lives."""

from __future__ import annotations

from typing import ClassVar

from services.dashboard.guesses import KnownBrowsers
from services.dashboard.learning_client import LearningClient
from services.dashboard.learning_page import add_learning_page
from services.dashboard.page import add_page
from services.dashboard.pages import add_pages
from services.dashboard.relay import Relay
from services.dashboard.sessions import Sessions
from services.dashboard.settings import DashboardSettings
from services.dashboard.setup_pages import add_setup_pages
from services.dashboard.setup_relay import add_setup_relay
from services.dashboard.staff_desk import StaffDesk
from services.dashboard.web_app import build_web_app
from shared.bus import Bus
from shared.http_server import serve
from shared.runner import Health, Service
from shared.settings import SettingsError
from shared.site import Site
from shared.weak_secrets import why_weak

__all__ = ["DashboardService"]

SHORTEST_KEY, SHORTEST_PASSWORD = 16, 12


class DashboardService(Service[DashboardSettings]):
    """Serves the live map; the bus only carries its sign of life."""

    name: ClassVar[str] = "dashboard"
    Settings: ClassVar[type[DashboardSettings]] = DashboardSettings

    def __init__(self, settings: DashboardSettings, site: Site, bus: Bus, health: Health) -> None:
        super().__init__(settings, site, bus, health)
        self._relay = Relay(settings.api_url, settings.api_key.get_secret_value(), self._told)

    @classmethod
    def check(cls, settings: DashboardSettings, site: Site) -> None:
        """Refuse secrets that are guessed in an afternoon."""
        if settings.profile == "demo":
            return
        weak = why_weak(settings.api_key.get_secret_value(), SHORTEST_KEY)
        if weak is not None:
            raise SettingsError(f"api_key: {weak}; set ATRIUM_API_KEY to a key of the API (openssl rand -hex 24)")
        password = settings.dashboard_password.get_secret_value()
        weak = why_weak(password, SHORTEST_PASSWORD) if password else None
        if weak is not None:
            raise SettingsError(
                f"dashboard_password: {weak}; set ATRIUM_DASHBOARD_PASSWORD to another, "
                "or to nothing: then only staff sign in, each by name"
            )

    def run(self) -> None:
        """Serve until the service stops."""
        settings = self.settings
        password, api_key = settings.dashboard_password.get_secret_value(), settings.api_key.get_secret_value()
        sessions = Sessions(password, api_key, settings.session_hours, staff_only=settings.profile != "demo")
        browsers, desk = KnownBrowsers(password, api_key), StaffDesk(settings.api_url, api_key)
        app = build_web_app(self._relay, sessions, browsers, desk, started=self.health.ready.set)
        title, can_sign_out = self.site.name or self.site.site, not sessions.open
        add_pages(app, settings.api_url, api_key, title, can_sign_out, self.site.time_zone)
        learning = LearningClient(settings.api_url, api_key)
        add_learning_page(learning, title, can_sign_out, self._access_points())
        add_setup_relay(app, settings.api_url, api_key)
        add_setup_pages(title, can_sign_out)
        add_page(app, title, can_sign_out)
        proxies = settings.dashboard_proxies
        serve(app, settings.dashboard_host, settings.dashboard_port, self.stopping, proxies=proxies)

    def stop(self) -> None:
        """End the browsers' streams first: the server waits for them."""
        self._relay.stop()
        super().stop()

    def _access_points(self) -> dict[str, list[str]]:
        """By area, the access points on its floor."""
        points = self.site.access_points
        return {area.id: [point.id for point in points if point.floor == area.floor] for area in self.site.areas}

    def _told(self, problem: str | None) -> None:
        if problem is None:
            self.health.well("api")
        else:
            self.health.degraded("api", problem)
