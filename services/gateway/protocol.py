"""What phones and gateway say to each other over HTTP, version ``/v1``: one Struct per body.

The OpenAPI page is generated from these Structs; ``docs/phone-app.md`` is the guide for the author of an app.
Times are seconds. Those a phone sends are on **its own clock**, however wrong that is; those it is sent are on the
server's. Unknown fields are ignored, so that versions can meet.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from services.gateway.reckoning.carrying import Carrying
from shared.messages import AlertKind, Covariance, InertialColumns

__all__ = [
    "Accepted",
    "Batch",
    "BatchReply",
    "Carrying",
    "Change",
    "Consent",
    "Echo",
    "Enrolled",
    "Enrolment",
    "ErrorReply",
    "FieldError",
    "NewToken",
    "OwnAlert",
    "OwnAlerts",
    "OwnConsent",
    "OwnDevice",
    "OwnExport",
    "OwnKept",
    "OwnLessons",
    "OwnRecord",
    "OwnSteps",
    "OwnWay",
    "Position",
    "RadioReadings",
    "TokenEntry",
    "TokenRequest",
    "Tokens",
    "TrialWalk",
    "TrialWalks",
    "TrialWalksReply",
    "WalkFound",
    "ZoneName",
]

Scope = Literal["post", "read", "manage"]


class Consent(msgspec.Struct, frozen=True, kw_only=True):
    """Reply 200 to ``GET /v1/consent``: what to show a visitor before enrolling."""

    version: str
    """Send it as ``consent_version``; it is stored with each consent."""
    text: str
    """Plain text."""


class Enrolment(msgspec.Struct, frozen=True, kw_only=True):
    """Body of ``POST /v1/devices``."""

    enrolment_key: str
    """The site's enrolment key, or the whole text that its QR code holds."""
    consent: bool
    """Must be true: the person carrying this phone has agreed to be located."""
    consent_version: str = ""
    """Which text the person has agreed to, as ``GET /v1/consent`` names it; empty: the one that is valid now."""
    name: str = ""
    """What the app calls itself; for the operator, at most 64 characters."""
    platform: str = ""
    """``android``, ``ios`` …, at most 64 characters."""
    carrying: Carrying = "unknown"
    """How the phone is carried; ``PATCH`` it when that changes."""
    transmitters: list[str] = []
    """The carrier's own transmitters (a tag, a wristband) that receivers hear; at most 8, with ``staff_key``:
    ``AA:BB:CC:DD:EE:FF``, ``iBeacon:UUID-MAJOR-MINOR`` or ``irk:`` and 32 hexadecimal digits."""
    staff_key: str = ""
    """With ``transmitters`` only: staff have seen that they are the carrier's own."""


class Enrolled(msgspec.Struct, frozen=True, kw_only=True):
    """Reply 201 to an enrolment. The token is shown this once."""

    device: str
    """Random; identifies the phone for this visit."""
    token: str
    """Send it as ``Authorization: Bearer TOKEN`` with every other request. It may do everything."""
    expires: float
    """When the token ends, server clock; enrol again then."""
    site: str
    consent_version: str
    time: float
    """The server's clock."""
    batches: str
    """Path to post batches to."""
    stream: str
    """Path of the WebSocket that takes the same batches."""
    position: str
    """Path to read the own position from."""
    alerts: str
    """Path to read the own alerts from."""


class Change(msgspec.Struct, frozen=True, kw_only=True):
    """Body of ``PATCH /v1/devices/{device}``."""

    carrying: Carrying
    """How the phone is carried from now on."""


class OwnDevice(msgspec.Struct, frozen=True, kw_only=True):
    """Reply 200 to a change."""

    device: str
    carrying: Carrying


class TokenRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Body of ``POST /v1/devices/{device}/tokens``: a token for another app, which may do less."""

    scopes: Annotated[list[Scope], msgspec.Meta(min_length=1, max_length=3)]
    """``post``: post batches. ``read``: read position, zones and alerts. ``manage``: everything else."""
    seconds: Annotated[float, msgspec.Meta(ge=60.0)] | None = None
    """How long it is valid, a minute or more; at most, and by default, as long as the token that asks for it."""


class NewToken(msgspec.Struct, frozen=True, kw_only=True):
    """Reply 201 to a request for a token, which is shown this once."""

    id: str
    """With which it can be revoked."""
    token: str
    scopes: list[Scope]
    expires: float
    """Server clock."""


class TokenEntry(msgspec.Struct, frozen=True, kw_only=True):
    """A token that is valid now; the token itself is stored nowhere."""

    id: str
    scopes: list[str]
    created: float
    """Server clock."""
    expires: float
    """Server clock."""
    asking: bool
    """True for the token with which this was asked."""


class Tokens(msgspec.Struct, frozen=True, kw_only=True):
    """Reply 200 to ``GET /v1/devices/{device}/tokens``."""

    tokens: list[TokenEntry]


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
    """Reply 200 or 202 to a batch, sent only after everything in it is on the bus."""

    seq: int
    duplicate: bool
    """True where this ``seq`` had been accepted before; nothing was published again."""
    received: float
    """Server clock when the request arrived."""
    replied: float
    """Server clock when this reply was written."""
    clock_offset: float
    """What the server adds to this phone's clock to get its own, seconds."""
    clock_drift: float = 0.0
    """How much faster the server's clock runs than this phone's, as a share: 1e-4 is 100 ppm."""
    late: bool = False
    """True, and status 202: it came too long after it was measured, for history and not for the live position."""
    accepted: Accepted
    ignored: dict[str, int]
    """What was not used, counted by reason."""


class ZoneName(msgspec.Struct, frozen=True, kw_only=True):
    """A zone of the site."""

    id: str
    name: str


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
    zones: list[ZoneName] = []
    """The site's zones that this position lies in."""


class OwnAlert(msgspec.Struct, frozen=True, kw_only=True):
    """What a rule of a zone told of this phone: it entered, left, stayed …"""

    t: float
    """When, server clock."""
    kind: AlertKind
    zone: str
    name: str
    floor: str
    x: float
    y: float


class OwnAlerts(msgspec.Struct, frozen=True, kw_only=True):
    """Reply 200 to ``GET /v1/devices/{device}/alerts``: the last ones, oldest first."""

    alerts: list[OwnAlert]


class OwnConsent(msgspec.Struct, frozen=True, kw_only=True):
    """To which text a visitor agreed, and when."""

    version: str
    given: float


class OwnSteps(msgspec.Struct, frozen=True, kw_only=True):
    """What trial walks told of how somebody walks; null where they told nothing."""

    peak: float | None
    mean: float | None
    """Step thresholds, m/s²."""
    slope: float | None
    offset: float | None
    """Of the line length = slope x cadence + offset; m per step/s, and m."""


class OwnLessons(msgspec.Struct, frozen=True, kw_only=True):
    """What learning found out about this phone and its carrier; null where nothing yet."""

    slope: float | None = None
    offset: float | None = None
    """As of ``OwnSteps``."""
    steps: int = 0
    """From so many steps."""
    heading_bias: float | None = None
    """Radians by which its headings are turned."""
    radio_offset: float | None = None
    """dB by which it hears more than other phones."""


class OwnKept(msgspec.Struct, frozen=True, kw_only=True):
    """One kind of thing that this site keeps of people, as it is set now."""

    service: str
    what: str
    seconds: float | None
    """For how long; null: until what ``note`` says."""
    note: str


class OwnRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Reply 200 to ``GET /v1/devices/{device}``: what is stored of this phone."""

    device: str
    name: str
    platform: str
    carrying: Carrying
    enrolled: float
    consents: list[OwnConsent]
    tokens: int
    """That open something now."""
    transmitters: int
    """Tags that are known as its carrier's, as keyed digests."""
    waiting: int
    """Messages of it that wait for the bus."""
    trial_walks: OwnSteps | None
    position: Position | None
    alerts: list[OwnAlert]
    """The last 50 of an hour."""
    learned: OwnLessons | None
    kept: list[OwnKept]
    """What the services of this site keep of people, and for how long."""
    silent: list[str]
    """Of history and learning, which know most: who did not answer; what they know is missing here."""


class OwnWay(msgspec.Struct, frozen=True, kw_only=True):
    """Where this phone was, as is known now, in parallel columns, and what was told of it; oldest first."""

    since: float
    until: float
    t: list[float]
    x: list[float]
    y: list[float]
    accuracy: list[float]
    """One sigma, m."""
    floor: list[str]
    alerts: list[OwnAlert]


class OwnExport(msgspec.Struct, frozen=True, kw_only=True):
    """Reply 200 to ``GET /v1/devices/{device}/export``: all that is stored of this phone, to be taken away."""

    record: OwnRecord
    ways: list[OwnWay]
    """One after the other, from its enrolment on."""


Place = tuple[float, float]


class TrialWalk(msgspec.Struct, frozen=True, kw_only=True):
    """One straight walk of known length, without halts; samples from before and after it do no harm."""

    imu: InertialColumns
    start: Place | None = None
    """Metres on the plan; with ``end`` in the place of ``distance``."""
    end: Place | None = None
    distance: float | None = None
    """Metres walked."""
    steps: int | None = None
    """Counted by the walker, at most 19; needed for the first walk."""


class TrialWalks(msgspec.Struct, frozen=True, kw_only=True):
    """Body of ``PUT …/trial-walks``: one walk for step detection, a second, faster one for lengths."""

    walks: Annotated[list[TrialWalk], msgspec.Meta(min_length=1, max_length=2)]


class WalkFound(msgspec.Struct, frozen=True, kw_only=True):
    """What was found in one trial walk."""

    steps: int
    """Detected."""
    cadence: float
    """Steps per second."""
    step_length: float
    """m."""


class TrialWalksReply(msgspec.Struct, frozen=True, kw_only=True):
    """Reply 200 to trial walks: what is used for this phone from now on."""

    peak: float
    """Step threshold: what the acceleration's norm exceeds at a step, m/s²."""
    mean: float
    """Step threshold: what its mean around a step exceeds, m/s²."""
    slope: float | None
    """``length = slope x cadence + offset``; null with one walk only. m per step/s."""
    offset: float | None
    """m."""
    walks: list[WalkFound]


class FieldError(msgspec.Struct, frozen=True, kw_only=True):
    """One thing that is wrong with a request."""

    field: str
    """Path inside the body such as ``imu.ax[3]``, a header, or ``body``."""
    problem: str
    found: str = ""
    allowed: str = ""


class ErrorReply(msgspec.Struct, frozen=True, kw_only=True):
    """Every reply of 400 and above has this body; on a WebSocket it answers a batch that was refused."""

    status: int
    """As the HTTP status."""
    detail: list[FieldError]
    retry_after: float | None = None
    """Seconds to wait before the same is sent again (429, 503)."""
