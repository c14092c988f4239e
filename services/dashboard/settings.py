"""What the dashboard can be told."""

from __future__ import annotations

from typing import Annotated, ClassVar
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, SecretStr

from shared.proxies import ProxyAddresses
from shared.settings import ServiceSettings

__all__ = ["DashboardSettings"]


def _http_url(text: str) -> str:
    parts = urlsplit(text)
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise ValueError("must be an address such as http://127.0.0.1:8081")
    if parts.username or parts.password:
        raise ValueError("must hold no user name or password; the key goes into api_key")
    return text.rstrip("/")


class DashboardSettings(ServiceSettings):
    """Where the dashboard listens, whom it asks, and who may look."""

    secrets: ClassVar[tuple[str, ...]] = ("api_key",)

    dashboard_host: str = Field("127.0.0.1", description="where browsers reach the dashboard")
    dashboard_port: int = Field(8082, ge=0, le=65535, description="0: any free port, printed at start")
    dashboard_proxies: ProxyAddresses = Field(
        [], description="addresses or networks of proxies in front: their X-Forwarded-* is believed; none by default"
    )
    api_url: Annotated[str, AfterValidator(_http_url)] = Field(
        "http://127.0.0.1:8081", description="the API service, as seen from this process"
    )
    api_key: SecretStr = Field(
        SecretStr("demo-api-key"),
        description="key of the API: for the live map, and for whoever has the shared password; browsers never see it",
    )
    dashboard_password: SecretStr = Field(
        SecretStr(""),
        description="shared password, for a wall screen; empty: staff only, by name; in the demo everybody",
    )
    session_hours: float = Field(12.0, gt=0, le=24 * 30, description="how long a browser stays signed in")
