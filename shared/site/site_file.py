"""The site file: what may stand in the YAML document that says what the space is.

``docs/site.md`` is the reference for its author; ``shared.site.site_loading`` reads one.
"""

from __future__ import annotations

import math
import os
import re
import zoneinfo
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, TypeVar
from urllib.parse import urlsplit

import numpy as np
import shapely
from pydantic import AfterValidator, Field, ValidationInfo, model_validator

from shared.keys import is_identifier
from shared.part_file import Part
from shared.redaction import redact_url
from shared.site.camera_geometry import CameraGeometry, LensModel
from shared.site.floor_plan import FloorPlan

__all__ = [
    "AccessPoint",
    "Anchor",
    "Area",
    "Camera",
    "Exhibit",
    "Floor",
    "Lens",
    "Part",
    "PointsGeometry",
    "PoseGeometry",
    "Site",
    "Source",
    "TsaiGeometry",
    "Zone",
    "expand_environment",
]


def expand_environment(text: str) -> str:
    """Replace ``${NAME}`` and ``${NAME:-default}`` by environment variables, so that passwords stay out of files.

    Raises:
        ValueError: a variable without a default is not set.
    """

    def value_of(match: re.Match[str]) -> str:
        name, default = match["name"], match["default"]
        value = os.environ.get(name) or default
        if value is None:
            raise ValueError(f"environment variable {name} is {'empty' if name in os.environ else 'not set'}")
        return value

    return re.sub(r"\$\{(?P<name>\w+)(?::-(?P<default>[^}]*))?\}", value_of, text)


def _identifier(text: str) -> str:
    if not is_identifier(text):
        raise ValueError("must be 1 to 64 of the letters, digits, '_', '.' and '-', starting with a letter or digit")
    return text


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError("must be a finite number")
    return value


def _positive(pair: tuple[float, float]) -> tuple[float, float]:
    if min(pair) <= 0.0:
        raise ValueError("must be two numbers above 0")
    return pair


def _simple_polygon(ring: list[tuple[float, float]]) -> list[tuple[float, float]]:
    if len(ring) < 3:
        raise ValueError(f"a polygon needs at least 3 corners, this one has {len(ring)}")
    polygon = shapely.Polygon(ring)
    if polygon.convex_hull.area <= 0.0:
        raise ValueError("the polygon encloses no area: its corners lie on one line")
    if not polygon.is_valid:
        raise ValueError(f"the polygon must not cross or touch itself ({shapely.is_valid_reason(polygon)})")
    return ring


def _time_zone(name: str) -> str:
    try:
        zoneinfo.ZoneInfo(name)
    except (ValueError, OSError, zoneinfo.ZoneInfoNotFoundError) as error:
        raise ValueError("must be an IANA time zone such as Europe/Rome or UTC") from error
    return name


def _inside_folder(path: Path, info: ValidationInfo) -> Path:
    """Read a path as the site file's author means it: relative to the file, with environment variables."""
    try:
        expanded = Path(expand_environment(str(path))).expanduser()
    except RuntimeError as error:  # ~somebody who is not here
        raise ValueError(str(error)) from error
    folder = (info.context or {}).get("folder", Path())
    return expanded if expanded.is_absolute() else (folder / expanded).resolve()


Identifier = Annotated[str, AfterValidator(_identifier)]
Number = Annotated[float, AfterValidator(_finite)]
Point = tuple[Number, Number]
Point3 = tuple[Number, Number, Number]
Polygon = Annotated[list[Point], AfterValidator(_simple_polygon)]
SitePath = Annotated[Path, AfterValidator(_inside_folder)]
Url = Annotated[str, AfterValidator(expand_environment)]
ImageSize = tuple[Annotated[int, Field(ge=16, le=16384)], Annotated[int, Field(ge=16, le=16384)]]


class Obstacle(Part):
    """Something nobody stands in: an exhibit, a pillar, a counter."""

    id: Identifier
    polygon: Polygon


class Floor(Part):
    """One storey; positions are only comparable on the same floor."""

    id: Identifier
    name: str = ""
    level: int = 0
    outline: Polygon
    walls: list[Annotated[list[Point], Field(min_length=2)]] = []
    obstacles: list[Obstacle] = []

    def plan(self) -> FloorPlan:
        """Return the floor's geometry."""
        return FloorPlan.build(self.outline, self.walls, [obstacle.polygon for obstacle in self.obstacles])


class Area(Part):
    """What one fusion process tracks; an area lies on one floor."""

    id: Identifier
    floor: Identifier


class Source(Part):
    """Where a camera's pictures come from: exactly one of ``file``, ``folder``, ``url``, ``device``."""

    file: SitePath | None = None
    folder: SitePath | None = None
    url: Url | None = None
    device: Annotated[int, Field(ge=0)] | None = None
    frames_per_s: Annotated[Number, Field(gt=0, le=240)] | None = None
    """Overrides what the file says of itself; required for a folder."""
    loop: bool = False

    @model_validator(mode="after")
    def _exactly_one(self) -> Source:
        given = [name for name in ("file", "folder", "url", "device") if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(given) if given else "none"
            raise ValueError(f"exactly one of file, folder, url, device is needed, found {found}")
        if self.folder is not None and self.frames_per_s is None:
            raise ValueError("a folder of pictures needs frames_per_s")
        if self.url is not None and urlsplit(self.url).scheme not in ("rtsp", "rtsps", "http", "https"):
            raise ValueError(f"{redact_url(self.url)!r}: a URL must start with rtsp, rtsps, http or https")
        return self

    def __str__(self) -> str:
        """Name the source for logs, passwords hidden."""
        if self.url is not None:
            return redact_url(self.url)
        return str(self.file or self.folder or f"device {self.device}")


class TsaiGeometry(Part):
    """A Tsai calibration file in XML."""

    kind: Literal["tsai"]
    file: SitePath

    def build(self) -> CameraGeometry:
        """Return the calibrated camera."""
        return CameraGeometry.from_tsai_file(self.file)


class Lens(Part):
    """A calibrated lens, as ``atrium calibrate-lens`` finds it: k1 and k2 of OpenCV's model, the rest in pixels."""

    image_size: ImageSize
    focal: Annotated[tuple[Number, Number], AfterValidator(_positive)]
    centre: Point
    k1: Annotated[Number, Field(ge=-5, le=5)]
    k2: Annotated[Number, Field(ge=-25, le=25)] = 0.0

    def model(self, image_size: tuple[int, int]) -> LensModel:
        """Return the lens for pictures of another size (pixel centres at integers)."""
        sx, sy = (wanted / own for wanted, own in zip(image_size, self.image_size, strict=True))
        return LensModel(
            focal=(self.focal[0] * sx, self.focal[1] * sy),
            centre=((self.centre[0] + 0.5) * sx - 0.5, (self.centre[1] + 0.5) * sy - 0.5),
            radial=(self.k1, self.k2),
        )


class PointsGeometry(Part):
    """At least four pairs of a pixel and the place on the floor it shows."""

    kind: Literal["points"]
    image_size: ImageSize
    image: Annotated[list[Point], Field(min_length=4)]
    plan: Annotated[list[Point], Field(min_length=4)]
    lens: Lens | None = None
    """Where the lens was calibrated; otherwise straight lines are taken to be straight in the picture."""

    def build(self) -> CameraGeometry:
        """Return the calibrated camera."""
        lens = None if self.lens is None else self.lens.model(self.image_size)
        return CameraGeometry.from_points(self.image_size, np.array(self.image), np.array(self.plan), lens)


class PoseGeometry(Part):
    """How the camera was mounted: position, the point in the centre of its picture, angle of view in degrees."""

    kind: Literal["pose"]
    image_size: ImageSize
    position: Point3
    look_at: Point3
    horizontal_fov: Annotated[Number, Field(gt=1, lt=170)]

    def build(self) -> CameraGeometry:
        """Return the calibrated camera."""
        fov = math.radians(self.horizontal_fov)
        return CameraGeometry.from_pose(self.image_size, self.position, self.look_at, fov)


class Camera(Part):
    """One camera: its pictures, its geometry, and which part of its picture matters."""

    id: Identifier
    area: Identifier
    source: Source
    geometry: Annotated[TsaiGeometry | PointsGeometry | PoseGeometry, Field(discriminator="kind")]
    area_of_interest: Polygon | None = None
    """In pixels of the geometry's image size; feet outside it are ignored."""
    latency: Annotated[Number, Field(ge=0, le=10)] = 0.0
    """Seconds between the light and the arrival of the frame, for live sources."""


class AccessPoint(Part):
    """A radio: where it hangs, the addresses it transmits with, and a first guess of its strength."""

    id: Identifier
    floor: Identifier
    position: Point3 | None = None
    """None: nobody knows; fusion does without it until learning has found it."""
    addresses: list[str] = []
    receivers: list[str] = []
    """Names under which fixed receivers that stand here report what they hear (FIND3, ESPresense, Theengs)."""
    kind: Literal["wifi", "ble"] = "wifi"
    power_1m: Annotated[Number, Field(ge=-110, le=0)] = -40.0
    """P₀: received power one metre away, dBm."""
    path_loss_exponent: Annotated[Number, Field(ge=1, le=6)] = 2.2


class Zone(Part):
    """A polygon with a name whose crossings are told."""

    id: Identifier
    name: str = ""
    floor: Identifier
    polygon: Polygon
    alert_on: list[Literal["enter", "exit"]] = ["enter", "exit"]


class Exhibit(Part):
    """Something to look at: where it stands or hangs, and from how far and from where it is looked at."""

    id: Identifier
    name: str = ""
    floor: Identifier
    position: Point
    reach: Annotated[Number, Field(gt=0, le=100)] = 8.0
    """Metres from which it is looked at, at most."""
    facing: Annotated[Number, Field(ge=-360, le=360)] | None = None
    """Where its front looks, degrees counter-clockwise from +x; None: it has no back."""


class Anchor(Part):
    """Where the plan's zero lies, WGS 84 degrees; how the plan is turned says ``north``."""

    latitude: Annotated[Number, Field(ge=-85, le=85)]
    longitude: Annotated[Number, Field(ge=-180, le=180)]


class Site(Part):
    """Everything the site file says."""

    format: Literal["atrium-site/1"]
    site: Identifier
    name: str = ""
    north: Annotated[Number, Field(ge=-360, le=360)] = 90.0
    """Direction of the compass's north on the plan, degrees counter-clockwise from the +x axis."""
    time_zone: Annotated[str, AfterValidator(_time_zone)] = "UTC"
    """IANA name such as Europe/Rome: rules days and schedules."""
    anchor: Anchor | None = None
    """Where the plan lies on Earth; without it there are no geographic coordinates."""
    floors: Annotated[list[Floor], Field(min_length=1)]
    areas: Annotated[list[Area], Field(min_length=1)]
    cameras: list[Camera] = []
    access_points: list[AccessPoint] = []
    zones: list[Zone] = []
    exhibits: list[Exhibit] = []

    def floor(self, floor_id: str) -> Floor:
        """Return the floor with this id (KeyError if there is none)."""
        return _by_id(self.floors, floor_id)

    def area(self, area_id: str) -> Area:
        """Return the area with this id (KeyError if there is none)."""
        return _by_id(self.areas, area_id)

    def camera(self, camera_id: str) -> Camera:
        """Return the camera with this id (KeyError if there is none)."""
        return _by_id(self.cameras, camera_id)

    def cameras_of(self, area_id: str) -> list[Camera]:
        """Return the cameras that watch one area."""
        return [camera for camera in self.cameras if camera.area == area_id]

    @property
    def north_radians(self) -> float:
        """Direction of north on the plan, radians counter-clockwise from +x."""
        return math.radians(self.north)


P = TypeVar("P", Floor, Area, Camera)


def _by_id(parts: Sequence[P], wanted: str) -> P:
    for part in parts:
        if part.id == wanted:
            return part
    known = ", ".join(part.id for part in parts) or "none"
    raise KeyError(f"{wanted!r} is not in the site file; it has: {known}")
