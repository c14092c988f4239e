"""What the gateway can be told."""

from __future__ import annotations

import ipaddress
import os
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import BeforeValidator, Field, SecretStr, ValidationInfo, field_validator, model_validator

from services.gateway.adapters.mqtt_broker import Broker, check_filter
from services.gateway.devices.erasures import KEPT as ERASURES_KEPT
from services.gateway.devices.tokens import keys_of
from services.gateway.phones.batch_check import Limits
from shared.kept import Kept
from shared.proxies import ProxyAddresses
from shared.settings import ServiceSettings

__all__ = ["GatewaySettings", "default_database_url"]

DEFAULT_DATABASE = "sqlite:///atrium.db"
DEMO_TOKEN_KEY = "a demo key for tokens that everybody knows"  # noqa: S105
SHORTEST_KEY = 32
"""Characters: HS256 asks for a key as long as its digest (RFC 7518, section 3.2)."""

StepDetectorName = Literal["shipped", "adaptive-dft", "gated-peaks", "personal-thresholds", "step-hmm"]
"""``shipped``, or one of ``steps.detectors.DETECTORS``."""
OptionalPath = Annotated[Path | None, BeforeValidator(lambda value: value or None)]
"""An empty variable is no path."""


def default_database_url() -> str:
    """Return ``ATRIUM_DATABASE_URL`` or the embedded default, ``atrium.db`` in the working directory."""
    return os.environ.get("ATRIUM_DATABASE_URL") or DEFAULT_DATABASE


class GatewaySettings(ServiceSettings):
    """Settings of the gateway."""

    secrets: ClassVar[tuple[str, ...]] = ("enrolment_key", "token_key", "address_key")

    gateway_host: str = Field("127.0.0.1", description="where phones reach the gateway")
    gateway_port: int = Field(8080, ge=0, le=65535, description="0: any free port, printed at start")
    gateway_public_url: str = Field("", description="base URL in the QR code; empty: as the request came")
    enrolment_key: SecretStr = Field(
        SecretStr("demo-enrolment-key"), min_length=8, max_length=256, description="phones enrol with it"
    )
    staff_key: SecretStr | None = Field(
        None, min_length=8, max_length=256, description="shows the QR code too, without being printed on walls"
    )
    tls_certificate: OptionalPath = Field(None, description="PEM file of the certificate chain: phones use HTTPS")
    tls_key: OptionalPath = Field(None, description="PEM file of the certificate's key")
    behind_proxy: bool = Field(False, description="a proxy in front ends TLS; the gateway itself may speak plain HTTP")
    proxy_addresses: ProxyAddresses = Field(
        ["127.0.0.1", "::1"],
        min_length=1,
        description="addresses or networks of that proxy: its X-Forwarded-* is believed",
    )
    keep_alive: int = Field(15, ge=1, le=600, description="seconds after which an idle connection is closed")
    connections: int = Field(4000, ge=10, description="open at once; more are answered 503")
    body_seconds: float = Field(30.0, gt=0, description="within which a body must have come")
    open_bodies: int = Field(8, ge=1, description="bodies on their way at once, of one device or enrolling address")
    consent_file: OptionalPath = Field(None, description="what visitors agree to: a line `version: NAME`, then text")
    token_key: SecretStr = Field(
        SecretStr(DEMO_TOKEN_KEY),
        description=f"signs tokens; {SHORTEST_KEY} characters or more. Several, separated by commas: the first signs",
    )
    token_days: float = Field(7.0, gt=0, le=366, description="how long a phone's token is valid: a visit")
    address_key: SecretStr = Field(
        SecretStr("a demo key for addresses"),
        min_length=16,
        max_length=256,
        description="digests the addresses of enrolled transmitters",
    )
    database_url: SecretStr = Field(SecretStr(DEFAULT_DATABASE), description="devices and consents (SQLAlchemy URL)")
    batch_bytes: int = Field(1 << 21, ge=1024, le=1 << 28, description="largest body of a batch")
    batch_samples: int = Field(12_000, ge=2, description="most inertial samples in a batch")
    batch_scans: int = Field(200, ge=1, description="most radio scans in a batch")
    scan_readings: int = Field(500, ge=1, description="most readings in one scan")
    batch_age: float = Field(3600.0, gt=0, description="oldest measurement accepted, seconds before it is sent")
    enrolments_per_minute: float = Field(60.0, gt=0, description="of one client address; a wrong key counts tenfold")
    enrolment_burst: int = Field(200, ge=10, description="enrolments at once, of one client address")
    batches_per_second: float = Field(25.0, gt=0, description="of one device in the long run")
    batch_burst: int = Field(250, ge=1, description="batches at once, of one device")
    live_lateness: float = Field(
        5.0, gt=0, description="seconds after which what was measured is late for live positions"
    )
    spool_bytes: int = Field(
        1 << 28,
        ge=0,
        description="messages of phones kept in the database while the bus is away; 0: batches are refused",
    )
    token_recheck: float = Field(
        60.0, gt=0, le=3600, description="seconds after which the database is asked again whose token it is"
    )
    step_detector: StepDetectorName = Field(
        "shipped", description="which step detector; shipped: the one that counts best, by how a phone is carried"
    )
    phone_idle: float = Field(300.0, gt=0, description="seconds of silence after which a phone's walk is forgotten")
    position_kept: float = Field(60.0, gt=0, description="seconds a phone is told its last position")
    alerts_kept: float = Field(3600.0, gt=0, description="seconds a phone is told that it entered or left a zone")
    receiver_key: SecretStr | None = Field(
        None, min_length=16, max_length=256, description="FIND3's fixed receivers post with it; empty: none may"
    )
    receiver_readings: int = Field(2000, ge=1, description="most readings of each kind in one post of a receiver")
    mqtt_url: SecretStr | None = Field(
        None, description="broker of fixed receivers, mqtt(s)://USER:PASSWORD@HOST:PORT; empty: none"
    )
    mqtt_topics: list[str] = Field(
        ["espresense/devices/+/+", "home/+/BTtoMQTT/+"], min_length=1, description="what receivers publish on"
    )
    mqtt_authorities: OptionalPath = Field(
        None, description="PEM file of who may sign the broker's certificate; empty: whom the system trusts"
    )

    @field_validator("token_key")
    @classmethod
    def _long_enough(cls, value: SecretStr, info: ValidationInfo) -> SecretStr:
        keys = keys_of(value.get_secret_value())
        if not keys or any(len(key) < SHORTEST_KEY for key in keys):
            raise ValueError(f"each key needs {SHORTEST_KEY} characters or more; make one with `openssl rand -hex 24`")
        if len(keys) > 1 and DEMO_TOKEN_KEY in keys and info.data.get("profile") != "demo":
            raise ValueError("the demo's key must not be among them")
        return value

    @field_validator("staff_key", "receiver_key", "mqtt_url", mode="before")
    @classmethod
    def _empty_is_none(cls, value: object) -> object:
        return None if value == "" else value

    @field_validator("mqtt_url")
    @classmethod
    def _broker(cls, value: SecretStr | None) -> SecretStr | None:
        if value is not None:
            Broker.of(value.get_secret_value())
        return value

    @field_validator("mqtt_topics")
    @classmethod
    def _filters(cls, value: list[str]) -> list[str]:
        return [check_filter(topic) for topic in value]

    @model_validator(mode="after")
    def _encrypted(self) -> GatewaySettings:
        if (self.tls_certificate is None) != (self.tls_key is None):
            raise ValueError("tls_certificate and tls_key: both are needed for HTTPS, or neither")
        plain = self.tls_certificate is None and not self.behind_proxy
        if self.profile != "demo" and plain and not _is_loopback(self.gateway_host):
            raise ValueError(
                f"gateway_host: {self.gateway_host} is open to the network and tokens would travel in plain text; "
                "set ATRIUM_TLS_CERTIFICATE and ATRIUM_TLS_KEY, or ATRIUM_BEHIND_PROXY=true where a proxy ends TLS"
            )
        if self.profile != "demo" and self.behind_proxy and not self.gateway_public_url.startswith("https://"):
            raise ValueError(
                f"gateway_public_url: {self.gateway_public_url!r} is no https:// URL, and the QR code carries it; "
                "behind a proxy set ATRIUM_GATEWAY_PUBLIC_URL to the proxy's"
            )
        return self

    def limits(self) -> Limits:
        """How much a batch may hold."""
        return Limits(self.batch_samples, self.batch_scans, self.scan_readings, age=self.batch_age)

    def kept(self) -> list[Kept]:
        """What the gateway keeps of phones."""
        return [
            Kept(
                what="that a phone was enrolled, and its consent to which text",
                note="until it is taken back; then only when it was given and taken back",
            ),
            Kept(what="that a phone's token is valid", settings=("token_days",), seconds=self.token_days * 86400.0),
            Kept(what="what trial walks told", note="until the consent is taken back"),
            Kept(what="where a phone was last", settings=("position_kept",), seconds=self.position_kept),
            Kept(what="which zones a phone entered and left", settings=("alerts_kept",), seconds=self.alerts_kept),
            Kept(what="how a phone walks now", settings=("phone_idle",), seconds=self.phone_idle),
            Kept(
                what="what phones told while the bus was away",
                settings=("spool_bytes",),
                note=f"until it is there again; {self.spool_bytes >> 20} MB at most",
            ),
            Kept(what="whom everybody is to forget", seconds=ERASURES_KEPT),
        ]


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
