"""What phones and gateway say to each other over HTTP, version ``/v1``: one Struct per body.

The OpenAPI page is generated from these Structs; ``docs/phone-app.md`` is the guide for the author of an app.
Times are seconds. Those a phone sends are on **its own clock**, however wrong that is; those it is sent are on the
server's. Unknown fields are ignored, so that versions can meet.
"""

from __future__ import annotations

from typing import Literal

import msgspec

from shared.messages import Covariance, InertialColumns

__all__ = [
    "API_VERSION",
    "CONSENT_VERSION",
    "Accepted",
    "Batch",
    "BatchReply",
    "Echo",
    "Enrolled",
    "Enrolment",
    "ErrorReply",
    "FieldError",
    "Position",
    "RadioReadings",
]

API_VERSION = "v1"
CONSENT_VERSION = "1"
"""Version of the text a visitor agrees to; stored with each consent."""

Carrying = Literal["hand", "pocket", "bag", "unknown"]


class Enrolment(msgspec.Struct, frozen=True, kw_only=True):
    """Body of ``POST /v1/devices``."""

    enrolment_key: str
    """The site's enrolment key, or the whole text that its QR code holds."""
    consent: bool
    """Must be true: the person carrying this phone has agreed to be located."""
    consent_version: str = CONSENT_VERSION
    """Which text the person has agreed to."""
    name: str = ""
    """What the app calls itself; for the operator, at most 64 characters."""
    platform: str = ""
    """``android``, ``ios`` …, at most 64 characters."""
    carrying: Carrying = "unknown"
    """How the phone is carried; the heading of a phone in a pocket or bag is published as unknown."""


class Enrolled(msgspec.Struct, frozen=True, kw_only=True):
    """Reply 201 to an enrolment. The token is shown this once."""

    device: str
    """Random; identifies the phone for this visit."""
    token: str
    """Send it as ``Authorization: Bearer TOKEN`` with every other request."""
    site: str
    consent_version: str
    time: float
    """The server's clock."""
    batches: str
    """Path to post batches to."""
    position: str
    """Path to read the own position from."""


class RadioReadings(msgspec.Struct, frozen=True, kw_only=True):
    """One radio scan: which transmitters were heard how strongly."""

    t: float
    """When the scan ended, phone clock."""
    kind: Literal["wifi", "ble"] = "wifi"
    address: list[str] = []
    """Addresses as the phone sees them (BSSID, beacon); case does not matter. Unknown ones are dropped and counted."""
    rssi: list[float] = []
    """dBm, -130 to 20, one per address."""


class Echo(msgspec.Struct, frozen=True, kw_only=True):
    """Optional: when the previous reply left the server and when it arrived; halves the error of the clock offset."""

    replied: float
    """``replied`` of that reply (server clock)."""
    arrived: float
    """When it arrived (phone clock)."""


class Batch(msgspec.Struct, frozen=True, kw_only=True):
    """Body of ``POST /v1/devices/{device}/batches``: what the phone measured since the last one, about once a second.

    ``imu`` holds parallel columns: ``t`` on the phone clock; ``ax ay az`` m/s² **with gravity** (flat at rest:
    az = +9.81); ``gx gy gz`` rad/s; ``mx my mz`` µT (leave out where there is no compass). Axes as Android has them:
    x to the right, y to the top of the phone, z out of the screen.
    """

    sent: float
    """Phone clock when this body was written."""
    seq: int
    """Counts up by one per batch, from 0. The same ``seq`` again is acknowledged and otherwise ignored."""
    imu: InertialColumns | None = None
    radio: list[RadioReadings] = []
    echo: Echo | None = None


class Accepted(msgspec.Struct, frozen=True, kw_only=True):
    """How much of a batch was used."""

    samples: int = 0
    """Inertial samples."""
    scans: int = 0
    readings: int = 0
    """Radio readings of access points that the site knows."""


class BatchReply(msgspec.Struct, frozen=True, kw_only=True):
    """Reply 200 to a batch, sent only after everything in it is on the bus."""

    seq: int
    duplicate: bool
    """True where this ``seq`` had been accepted before; nothing was published again."""
    received: float
    """Server clock when the request arrived."""
    replied: float
    """Server clock when this reply was written."""
    clock_offset: float
    """What the server adds to this phone's clock to get its own, seconds."""
    accepted: Accepted
    ignored: dict[str, int]
    """What was not used, counted by reason."""


class Position(msgspec.Struct, frozen=True, kw_only=True):
    """Reply 200 to ``GET /v1/devices/{device}/position``: where this phone is, in metres on the plan."""

    t: float
    """When it was there, server clock."""
    age: float
    """Seconds since then."""
    area: str
    floor: str
    x: float
    y: float
    covariance: Covariance
    """(xx, xy, yy) in m²."""
    probability: float
    """That the track is this phone's."""


class FieldError(msgspec.Struct, frozen=True, kw_only=True):
    """One thing that is wrong with a request."""

    field: str
    """Path inside the body such as ``imu.ax[3]``, a header, or ``body``."""
    problem: str
    found: str = ""
    allowed: str = ""


class ErrorReply(msgspec.Struct, frozen=True, kw_only=True):
    """Every reply of 400 and above has this body."""

    detail: list[FieldError]
