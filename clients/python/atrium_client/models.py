"""What the API answers, as far as a client needs it. Fields that this version does not know are ignored.

Metres on the site's plan; seconds since the epoch (UTC); covariances (xx, xy, yy) in m².
"""

from __future__ import annotations

import msgspec

__all__ = [
    "Alert",
    "Device",
    "DwellAtPlace",
    "DwellReport",
    "Exhibit",
    "ExhibitInFront",
    "Flows",
    "HeatMap",
    "InFront",
    "Occupancy",
    "OccupancyOfPlace",
    "Position",
    "Rule",
    "Schedule",
    "SignedIn",
    "Track",
    "Trajectory",
    "Zone",
]

Covariance = tuple[float, float, float]
Point = tuple[float, float]


class Position(msgspec.Struct, frozen=True, kw_only=True):
    """Where one device is; ``age``: seconds since what it was made from reached the system."""

    device: str
    area: str
    floor: str
    x: float
    y: float
    covariance: Covariance
    vx: float
    vy: float
    t: float
    age: float
    track: int
    probability: float
    state: str
    """confirmed, coasting, unseen or lost."""
    accuracy: float | None = None
    """Metres: standard deviation along the direction that is known worst."""


class Track(msgspec.Struct, frozen=True, kw_only=True):
    """One person, with a known device or without."""

    track: int
    area: str
    floor: str
    x: float
    y: float
    covariance: Covariance
    vx: float
    vy: float
    t: float
    age: float
    state: str
    device: str | None
    probability: float
    """Of ``device`` being right; where it is None, of the person carrying none of the known ones."""
    quality: float
    device_since: float | None = None
    """Since when ``device`` has been this person's, without a break."""
    runner_up: str | None = None
    runner_up_probability: float = 0.0
    former: list[int] = msgspec.field(default_factory=list)
    """Earlier numbers of the same person, oldest first."""
    sources: list[str] = msgspec.field(default_factory=list)
    """Cameras that saw the person, and phones that told of them, in the last second."""
    accuracy: float | None = None
    """As of positions."""


class Device(msgspec.Struct, frozen=True, kw_only=True):
    """How surely and how lately a device is located, and in which zones."""

    device: str
    state: str
    area: str
    floor: str
    zones: list[str]
    probability: float
    t: float
    age: float


class Schedule(msgspec.Struct, kw_only=True):
    """When a rule holds, by the site's clock; 0 is Monday; ``until`` before ``since`` runs past midnight."""

    days: list[int] = msgspec.field(default_factory=lambda: list(range(7)))
    since: str = "00:00"
    until: str = "00:00"


class Rule(msgspec.Struct, kw_only=True):
    """One thing that is told of a zone."""

    id: str
    kind: str
    """enter, exit, dwell, cross, crowd, proximity or speed."""
    limit: float | None = None
    """Seconds of dwell, people of a crowd, metres of proximity, m/s of speed."""
    direction: str = "both"
    target: str = ""
    audience: str = "everybody"
    devices: list[str] = msgspec.field(default_factory=list)
    schedule: Schedule | None = None
    confidence: float = 0.5
    quiet: float = 0.0


class Zone(msgspec.Struct, kw_only=True):
    """An area, or a line that people cross; what is read of it may be changed and put back."""

    id: str
    floor: str
    points: list[Point]
    name: str = ""
    shape: str = "area"
    rules: list[Rule] = msgspec.field(default_factory=list)
    inside: int = 0
    """People in it now whom cameras see; ``unseen``: devices out of their view."""
    unseen: int = 0
    blind: bool = False
    """No camera can see it now: nobody knows how many are there."""
    etag: str = ""
    """Which state of it was read; empty: of one's own making."""


class Exhibit(msgspec.Struct, kw_only=True):
    """Something to look at; ``facing``: degrees counter-clockwise from the plan's +x, None: it has no back."""

    id: str
    floor: str
    x: float
    y: float
    name: str = ""
    reach: float = 8.0
    facing: float | None = None
    etag: str = ""


class ExhibitInFront(msgspec.Struct, frozen=True, kw_only=True):
    """One exhibit that a visitor may be looking at; ``bearing``: degrees left of how they walked last."""

    id: str
    name: str
    distance: float
    bearing: float | None
    probability: float | None = None
    """Of its being what they look at."""


class InFront(msgspec.Struct, frozen=True, kw_only=True):
    """What one visitor may be looking at, the most probable first."""

    device: str
    floor: str
    x: float
    y: float
    age: float
    heading: float | None
    heading_age: float | None
    exhibits: list[ExhibitInFront]
    state: str = ""
    """As of positions."""


class Acknowledgement(msgspec.Struct, frozen=True, kw_only=True):
    """Who looked at an alert, when, and what they said of it."""

    by: str
    at: float
    note: str = ""


class Alert(msgspec.Struct, frozen=True, kw_only=True):
    """What a rule of a zone asked to be told."""

    t: float
    id: str
    zone: str
    kind: str
    area: str
    track: int
    floor: str
    x: float
    y: float
    device: str | None = None
    rule: str = ""
    value: float | None = None
    limit: float | None = None
    acknowledged: Acknowledgement | None = None


class StoreErased(msgspec.Struct, frozen=True, kw_only=True):
    """A service that has nothing more of a device, and since when."""

    service: str
    t: float


class Erasure(msgspec.Struct, frozen=True, kw_only=True):
    """A device whose consent has ended; ``waiting``: services that have not said yet that they hold nothing of it."""

    device: str
    t: float
    done: list[StoreErased]
    waiting: list[str]


class Trajectory(msgspec.Struct, frozen=True, kw_only=True):
    """Where one device was, revisions applied: parallel columns, oldest first; ``accuracy``: one sigma."""

    device: str
    since: float
    until: float
    t: list[float]
    floor: list[str]
    x: list[float]
    y: list[float]
    accuracy: list[float]
    probability: list[float]
    track: list[int]
    """0 where no camera saw it."""
    state: list[str]


class OccupancyOfPlace(msgspec.Struct, frozen=True, kw_only=True):
    """People in one zone or area, step by step: in the mean, at most, and phones; None where nothing was counted."""

    id: str
    people: list[float | None]
    most: list[int | None]
    phones: list[float | None]


class Occupancy(msgspec.Struct, frozen=True, kw_only=True):
    """How many people were where; ``t``: when each step of so many seconds begins, by the site's clock."""

    since: float
    until: float
    step: int
    time_zone: str
    t: list[float]
    places: list[OccupancyOfPlace]


class HeatMap(msgspec.Struct, frozen=True, kw_only=True):
    """Seconds and people per cell of a floor, rows go up from ``origin``; None where too few were to tell."""

    floor: str
    since: float
    until: float
    origin: Point
    cell: float
    seconds: list[list[float | None]]
    people: list[list[int | None]]


class DwellAtPlace(msgspec.Struct, frozen=True, kw_only=True):
    """Stays at one place; mean, median and 90th percentile in seconds, all None where too few were to tell."""

    id: str
    people: int | None
    visits: int | None
    mean: float | None
    median: float | None
    p90: float | None


class DwellReport(msgspec.Struct, frozen=True, kw_only=True):
    """How long people stayed at each place."""

    since: float
    until: float
    places: list[DwellAtPlace]


class Flows(msgspec.Struct, frozen=True, kw_only=True):
    """How often people went from the row's zone to the column's next; None where too few did to tell."""

    since: float
    until: float
    zones: list[str]
    counts: list[list[int | None]]


class SignedIn(msgspec.Struct, frozen=True, kw_only=True):
    """A sign-in of one of the staff."""

    token: str
    user: str
    role: str
    scopes: list[str]
    expires: float
