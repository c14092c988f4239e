"""What the gateway can be told."""

from __future__ import annotations

import os
from typing import ClassVar

from pydantic import Field, SecretStr

from services.gateway.phones.batch_check import Limits
from shared.settings import ServiceSettings

__all__ = ["GatewaySettings", "default_database_url"]

DEFAULT_DATABASE = "sqlite:///atrium.db"


def default_database_url() -> str:
    """Return ``ATRIUM_DATABASE_URL`` or the embedded default, ``atrium.db`` in the working directory."""
    return os.environ.get("ATRIUM_DATABASE_URL") or DEFAULT_DATABASE


class GatewaySettings(ServiceSettings):
    """Settings of the gateway."""

    secrets: ClassVar[tuple[str, ...]] = ("enrolment_key",)

    gateway_host: str = Field("127.0.0.1", description="where phones reach the gateway")
    gateway_port: int = Field(8080, ge=0, le=65535, description="0: any free port, printed at start")
    gateway_public_url: str = Field("", description="base URL in the QR code; empty: as the request came")
    enrolment_key: SecretStr = Field(
        SecretStr("demo-enrolment-key"), min_length=8, max_length=256, description="phones enrol with it"
    )
    staff_key: SecretStr | None = Field(
        None, min_length=8, max_length=256, description="shows the QR code too, without being printed on walls"
    )
    database_url: SecretStr = Field(SecretStr(DEFAULT_DATABASE), description="devices and consents (SQLAlchemy URL)")
    batch_bytes: int = Field(1 << 20, ge=1024, le=1 << 28, description="largest body of a batch")
    batch_samples: int = Field(12_000, ge=2, description="most inertial samples in a batch")
    batch_scans: int = Field(200, ge=1, description="most radio scans in a batch")
    scan_readings: int = Field(500, ge=1, description="most readings in one scan")
    batch_age: float = Field(3600.0, gt=0, description="oldest measurement accepted, seconds before it is sent")
    enrolments_per_minute: float = Field(60.0, gt=0, description="of one client address; a wrong key counts tenfold")
    enrolment_burst: int = Field(200, ge=10, description="enrolments at once, of one client address")
    token_recheck: float = Field(
        60.0, gt=0, le=3600, description="seconds after which the database is asked again whose token it is"
    )
    phone_idle: float = Field(300.0, gt=0, description="seconds of silence after which a phone's walk is forgotten")
    position_kept: float = Field(60.0, gt=0, description="seconds a phone is told its last position")

    def limits(self) -> Limits:
        """How much a batch may hold."""
        return Limits(self.batch_samples, self.batch_scans, self.scan_readings, age=self.batch_age)
