"""What the API answers: one Struct per body, from which both the bytes and the OpenAPI schemas are made.

Units as on the bus: metres, seconds since the epoch (UTC), m/s; covariances (xx, xy, yy) in m².
"""

from __future__ import annotations

from typing import Literal

import msgspec

from shared.messages import Covariance, TrackState
from shared.zones import ZoneRule

__all__ = [
    "AccessPointView",
    "AreaFreshness",
    "AreaView",
    "CameraReport",
    "CameraView",
    "Cameras",
    "Device",
    "Devices",
    "FloorView",
    "HealthReport",
    "ObstacleView",
    "Position",
    "PositionState",
    "Positions",
    "Reply",
    "Ring",
    "ServicePresence",
    "SiteView",
    "Track",
    "TrackColumns",
    "Tracks",
    "ZoneReport",
    "ZoneView",
    "Zones",
]

Ring = list[tuple[float, float]]
PositionState = Literal["confirmed", "coasting", "unseen", "lost"]
"""``lost``: no person in the area's newest frame carries the device; this is where it was last."""


class Reply(msgspec.Struct, frozen=True, kw_only=True):
    """What every body is."""


class Position(Reply, frozen=True, kw_only=True):
    """Where one device is, as of ``t``; ``age`` is how many seconds ago its source was received."""

    device: str
    area: str
    floor: str
    x: float
    y: float
    covariance: Covariance
    accuracy: float
    """Metres: standard deviation along the direction that is known worst."""
    vx: float
    vy: float
    t: float
    age: float
    track: int
    probability: float
    """Of the device being this person's."""
    state: PositionState


class Positions(Reply, frozen=True, kw_only=True):
    """All devices located now or lately; ``t`` is when the ages were taken."""

    t: float
    positions: list[Position]
    next: str | None = None
    """The ``cursor`` that asks for the next ones; null: these are all."""


class Track(Reply, frozen=True, kw_only=True):
    """One person, known or anonymous."""

    track: int
    area: str
    floor: str
    x: float
    y: float
    covariance: Covariance
    accuracy: float
    """As of positions."""
    vx: float
    vy: float
    t: float
    age: float
    state: TrackState
    device: str | None
    device_since: float | None
    """Since when ``device`` has been this person's without a break, of one area; null where there is none."""
    probability: float
    """Of ``device`` being right; where it is null, of the person carrying none of the known ones."""
    runner_up: str | None
    runner_up_probability: float
    former: list[int]
    sources: list[str]
    """Cameras that saw the person, and phones whose steps and radio told of them, in the last second."""
    quality: float


class Tracks(Reply, frozen=True, kw_only=True):
    """Everybody in the newest frame of each area."""

    t: float
    tracks: list[Track]
    next: str | None = None
    """As of positions."""


class Device(Reply, frozen=True, kw_only=True):
    """One device that is located, or was lately."""

    device: str
    state: PositionState
    area: str
    floor: str
    zones: list[str]
    """Where it is."""
    probability: float
    t: float
    age: float


class Devices(Reply, frozen=True, kw_only=True):
    """The devices, by name."""

    t: float
    devices: list[Device]
    next: str | None = None
    """As of positions."""


class TrackColumns(Reply, frozen=True, kw_only=True):
    """One area's newest frame as the stream sends it: parallel columns, one entry per person."""

    area: str
    t: float
    floor: list[str]
    track: list[int]
    x: list[float]
    y: list[float]
    vx: list[float]
    vy: list[float]
    state: list[TrackState]
    device: list[str | None]
    device_since: list[float | None]
    """Since when it has been this person's, without a break; null where there is none."""
    probability: list[float]
    quality: list[float]
    accuracy: list[float]
    """Metres: standard deviation along the direction that is known worst."""


class ZoneReport(Reply, frozen=True, kw_only=True):
    """One zone and how many people's positions lie in it now; of a line nobody.

    ``inside`` counts whom cameras see; ``unseen`` devices that are followed by steps and radio alone, whose carriers a
    camera may see and count as well.
    """

    id: str
    name: str
    floor: str
    shape: Literal["area", "line"]
    points: Ring
    rules: list[ZoneRule]
    polygon: Ring
    """The same as ``points``."""
    alert_on: list[Literal["enter", "exit"]]
    """Which of the two the rules tell."""
    inside: int
    unseen: int
    etag: str
    """For ``If-Match`` of a change; of the zone's definition, not of the counts."""


class Zones(Reply, frozen=True, kw_only=True):
    """The zones of the site."""

    t: float
    zones: list[ZoneReport]


class CameraReport(Reply, frozen=True, kw_only=True):
    """How one camera is doing; ``unknown`` until it has reported."""

    camera: str
    area: str
    state: Literal["unknown", "starting", "ok", "degraded", "ended"]
    reason: str
    frames: int
    dropped: int
    frames_per_s: float
    t: float | None
    age: float | None


class Cameras(Reply, frozen=True, kw_only=True):
    """The cameras of the site."""

    t: float
    cameras: list[CameraReport]


class ServicePresence(Reply, frozen=True, kw_only=True):
    """One process on the bus."""

    service: str
    instance: str
    alive: bool


class AreaFreshness(Reply, frozen=True, kw_only=True):
    """When an area was last heard of; null: never. ``people``: whom its cameras see."""

    area: str
    t: float | None
    age: float | None
    people: int


class HealthReport(Reply, frozen=True, kw_only=True):
    """Whether the system does its job, and what is wrong in plain words."""

    t: float
    status: Literal["ok", "degraded"]
    problems: list[str]
    services: list[ServicePresence]
    areas: list[AreaFreshness]
    cameras: list[CameraReport]


class ObstacleView(Reply, frozen=True, kw_only=True):
    """Something nobody stands in."""

    id: str
    polygon: Ring


class FloorView(Reply, frozen=True, kw_only=True):
    """One storey."""

    id: str
    name: str
    level: int
    outline: Ring
    walls: list[Ring]
    obstacles: list[ObstacleView]


class AreaView(Reply, frozen=True, kw_only=True):
    """What one fusion process tracks."""

    id: str
    floor: str


class CameraView(Reply, frozen=True, kw_only=True):
    """Where a camera hangs and the part of the floor it watches; never where its pictures come from."""

    id: str
    area: str
    floor: str
    position: tuple[float, float, float]
    footprint: Ring
    """Empty where the camera sees no floor of its plan."""


class AccessPointView(Reply, frozen=True, kw_only=True):
    """A radio at a known place."""

    id: str
    floor: str
    position: tuple[float, float, float] | None
    """As the site file says; null where it does not."""
    kind: Literal["wifi", "ble"]


class ZoneView(Reply, frozen=True, kw_only=True):
    """A polygon, or a line, with a name."""

    id: str
    name: str
    floor: str
    polygon: Ring
    shape: Literal["area", "line"] = "area"


class SiteView(Reply, frozen=True, kw_only=True):
    """What a map needs."""

    site: str
    name: str
    north: float
    """Direction of the compass's north on the plan, degrees counter-clockwise from +x."""
    floors: list[FloorView]
    areas: list[AreaView]
    cameras: list[CameraView]
    access_points: list[AccessPointView]
    zones: list[ZoneView]
