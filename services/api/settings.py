"""What the api service can be told."""

from __future__ import annotations

import json
import os
from ipaddress import IPv4Network, IPv6Network
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, SecretStr, field_validator
from pydantic_settings import NoDecode

from shared.kept import Kept
from shared.proxies import ProxyAddresses
from shared.settings import ServiceSettings
from shared.site import Site

__all__ = ["ALL_SCOPES", "DEMO_KEY", "READ_SCOPES", "ApiKey", "ApiSettings", "Scope", "default_api_database_url"]

DEMO_KEY = "demo-api-key"
DEFAULT_DATABASE = "sqlite:///atrium-api.db"

Scope = Literal[
    "positions",
    "alerts",
    "site",
    "health",
    "learning",
    "learning-admin",
    "zones-admin",
    "accounts",
    "audit",
    "acknowledge",
    "webhooks",
    "stills",
    "setup",
    "erase",
]
"""What a key may read: positions and tracks; alerts; the site, its zones and cameras; health; what is learned. And what
it may do: ``learning-admin`` rolls models back, freezes learning, takes models out and brings them in; ``zones-admin``
draws zones and exhibits; ``accounts`` issues keys and lets people in; ``audit`` reads who did what; ``acknowledge``
notes who looked at an alert; ``webhooks`` says where alerts are sent; ``stills``
sees pictures of cameras; ``setup`` saves calibrations and places of access points; ``erase`` ends the consent of a
phone, for a visitor who asks."""
ALL_SCOPES: tuple[Scope, ...] = get_args(Scope)
READ_SCOPES: tuple[Scope, ...] = ("positions", "alerts", "site", "health", "learning")
PAGES_SCOPES: tuple[Scope, ...] = (
    *READ_SCOPES,
    "acknowledge",
    "zones-admin",
    "learning-admin",
    "stills",
    "setup",
    "erase",
)
"""What the pages of the dashboard offer."""


class ApiKey(BaseModel):
    """One key of the staff and what it may read."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = "key"
    """Names the key in logs; never the key itself."""
    key: SecretStr = Field(min_length=8, max_length=256)
    scopes: tuple[Scope, ...] = READ_SCOPES


def _read_keys(value: Any) -> Any:
    """Accept ``KEY``, ``KEY,KEY``, a JSON list of keys or of {"name", "key", "scopes"}, or a mapping of name to either.

    A key given as bare text may read everything; the demo's may do everything.
    """
    if isinstance(value, str):
        text = value.strip()
        value = json.loads(text) if text.startswith(("[", "{")) else [part.strip() for part in text.split(",")]
    if isinstance(value, dict):
        value = [
            {"name": name, **entry} if isinstance(entry, dict) else {"name": name, "key": entry}
            for name, entry in value.items()
        ]
    if isinstance(value, list | tuple):
        return [
            {"name": f"key-{number}", "key": entry, **({"scopes": ALL_SCOPES} if entry == DEMO_KEY else {})}
            if isinstance(entry, str | SecretStr)
            else entry
            for number, entry in enumerate(value, start=1)
        ]
    return value


def default_api_database_url() -> str:
    """Return ``ATRIUM_API_DATABASE_URL``, else ``ATRIUM_DATABASE_URL``, else a file in the working directory."""
    variables = ("ATRIUM_API_DATABASE_URL", "ATRIUM_DATABASE_URL")
    return next((url for name in variables if (url := os.environ.get(name))), DEFAULT_DATABASE)


class ApiSettings(ServiceSettings):
    """Settings of the HTTP interface for staff software."""

    secrets: ClassVar[tuple[str, ...]] = ("api_keys",)

    api_host: str = Field("127.0.0.1", description="where the API listens")
    api_port: int = Field(8081, ge=0, le=65535, description="0: any free port, printed at start")
    api_keys: Annotated[tuple[ApiKey, ...], NoDecode, BeforeValidator(_read_keys)] = Field(
        (ApiKey(name="demo", key=SecretStr(DEMO_KEY), scopes=ALL_SCOPES),),
        description='keys of the staff: KEY[,KEY] (may read everything) or JSON [{"name","key","scopes"}]',
    )
    dashboard_key: Annotated[SecretStr | None, BeforeValidator(lambda value: value or None)] = Field(
        None,
        max_length=256,
        description="key of the dashboard: may do all its pages offer; one of api_keys has the scopes it has there",
    )
    api_proxies: ProxyAddresses = Field(
        [], description="addresses or networks of proxies in front: their X-Forwarded-* is believed; none by default"
    )
    api_database_url: SecretStr = Field(
        default_factory=lambda: SecretStr(default_api_database_url()),
        description="sqlite:///FILE or postgresql://USER:PASSWORD@HOST/NAME; the gateway's may be shared",
    )
    key_rate: float = Field(
        50.0, gt=0, le=100_000, description="requests per second of a key that is issued, unless it says otherwise"
    )
    session_rate: float = Field(100.0, gt=0, le=100_000, description="requests per second of a sign-in of staff")
    session_hours: float = Field(12.0, gt=0, le=720, description="hours until staff have to sign in again")
    audit_days: float = Field(365.0, gt=0, le=36500, description="days the audit log is kept")
    cors_origins: list[str] = Field([], description="web origins whose pages may call the API; none by default")
    positions_kept: float = Field(120.0, gt=0, le=86400, description="seconds a device's last known position is told")
    tracks_kept: float = Field(10.0, gt=0, le=3600, description="seconds an area's last tracks are told")
    stream_rate: float = Field(10.0, gt=0, le=100, description="track events per second and area on the stream")
    stream_keep_alive: float = Field(10.0, gt=0, le=300, description="seconds between comments on a silent stream")
    stream_readers: int = Field(1000, ge=1, le=100_000, description="streams open at once; more are answered 503")
    stream_readers_of_one: int = Field(
        100, ge=1, le=100_000, description="streams open at once with one key or by one person; more are answered 429"
    )
    stream_events: int = Field(100_000, ge=10, le=10_000_000, description="newest events held to resume from")
    stream_megabytes: float = Field(64.0, gt=0, le=4096, description="memory that they may take")
    stream_patience: float = Field(
        30.0, gt=0, le=600, description="seconds after which a client that reads nothing is dropped"
    )

    alerts_kept: int = Field(100_000, ge=1, le=10_000_000, description="alerts held, those that came first go first")
    alert_days: float = Field(30.0, gt=0, le=3660, description="days that alerts are held")
    webhook_networks: list[IPv4Network | IPv6Network] = Field(
        [], description="private networks that webhooks may be sent to all the same, such as 10.1.2.0/24"
    )
    webhooks_most: int = Field(100, ge=0, le=1000, description="webhooks at once")
    webhook_timeout: float = Field(10.0, gt=0, le=120, description="seconds a receiver may take")
    webhook_attempts: int = Field(12, ge=1, le=100, description="attempts until an alert is a dead letter")
    webhook_first_pause: float = Field(
        5.0, gt=0, le=3600, description="seconds before the second attempt, doubled before each that follows"
    )
    webhook_longest_pause: float = Field(3600.0, gt=0, le=86400, description="seconds between two attempts at most")
    webhook_waiting: int = Field(10_000, ge=1, le=1_000_000, description="alerts that wait for one webhook at most")
    webhook_dead_days: float = Field(7.0, gt=0, le=365, description="days that dead letters are held")

    stale_after: float = Field(3.0, gt=0, le=3600, description="seconds without tracks until health tells of it")
    expected_services: list[str] = Field(
        ["camera", "gateway", "fusion", "geofence", "learning", "history"],
        description="services whose absence is a problem",
    )

    @property
    def trusted_key(self) -> SecretStr | None:
        """The dashboard's: whoever shows it is believed for whose browser they ask."""
        return SecretStr(DEMO_KEY) if self.dashboard_key is None and self.profile == "demo" else self.dashboard_key

    @property
    def keys(self) -> tuple[ApiKey, ...]:
        """All keys of the settings, each once."""
        if self.dashboard_key is None or self.dashboard_key in [key.key for key in self.api_keys]:
            return self.api_keys
        scopes = ALL_SCOPES if self.dashboard_key.get_secret_value() == DEMO_KEY else PAGES_SCOPES
        return (*self.api_keys, ApiKey(name="dashboard", key=self.dashboard_key, scopes=scopes))

    @field_validator("api_keys")
    @classmethod
    def _distinct(cls, keys: tuple[ApiKey, ...]) -> tuple[ApiKey, ...]:
        if not keys:
            raise ValueError("at least one key is needed")
        if len({key.key.get_secret_value() for key in keys}) < len(keys):
            raise ValueError("the same key is listed twice")
        return keys

    def expected_of(self, site: Site) -> list[str]:
        """Return the services that should run at a site."""
        return [name for name in self.expected_services if name != "camera" or site.cameras]

    def kept(self) -> list[Kept]:
        """What the API keeps of people."""
        day = 86400.0
        return [
            Kept(what="where everybody is now", settings=("tracks_kept",), seconds=self.tracks_kept),
            Kept(what="where a phone was last", settings=("positions_kept",), seconds=self.positions_kept),
            Kept(
                what="alerts, for the inbox",
                settings=("alert_days", "alerts_kept"),
                seconds=self.alert_days * day,
                note=f"the newest {self.alerts_kept}",
            ),
            Kept(
                what="alerts that a webhook did not take",
                settings=("webhook_dead_days",),
                seconds=self.webhook_dead_days * day,
            ),
            Kept(
                what="what was told on streams",
                settings=("stream_events", "stream_megabytes"),
                note=f"in memory: the newest {self.stream_events} events, {self.stream_megabytes:g} MB at most",
            ),
            Kept(
                what="which of the staff looked up whom or changed what",
                settings=("audit_days",),
                seconds=self.audit_days * day,
            ),
        ]
