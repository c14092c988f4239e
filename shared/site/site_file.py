"""The site file: one YAML document that says what the space is; validated whole before anything starts.

Every mistake is one message that names the file, the path inside it, the value found and what is allowed.
``docs/site.md`` is the reference for its author.
"""

from __future__ import annotations

import math
import os
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Literal, TypeVar
from urllib.parse import urlsplit, urlunsplit

import numpy as np
import shapely
import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, model_validator

from shared.keys import is_identifier
from shared.site.camera_geometry import CameraGeometry, GeometryError
from shared.site.floor_plan import FloorPlan

__all__ = [
    "AccessPoint",
    "Area",
    "Camera",
    "Floor",
    "Site",
    "SiteError",
    "Source",
    "Zone",
    "expand_environment",
    "load_site",
    "redact_url",
]


class SiteError(ValueError):
    """The site file cannot be used: the text names file, path inside it, value and what is allowed."""


def expand_environment(text: str) -> str:
    """Replace ``${NAME}`` and ``${NAME:-default}`` by environment variables, so that passwords stay out of files.

    Raises:
        ValueError: a variable without a default is not set.
    """

    def value_of(match: re.Match[str]) -> str:
        name, default = match["name"], match["default"]
        value = os.environ.get(name) or default
        if value is None:
            raise ValueError(f"environment variable {name} is not set")
        return value

    return re.sub(r"\$\{(?P<name>\w+)(?::-(?P<default>[^}]*))?\}", value_of, text)


def redact_url(url: str) -> str:
    """Return the URL with its user name and password hidden."""
    parts = urlsplit(url)
    if "@" not in parts.netloc:
        return url
    return urlunsplit(parts._replace(netloc="***@" + parts.netloc.rsplit("@", 1)[1]))


def _identifier(text: str) -> str:
    if not is_identifier(text):
        raise ValueError("must be 1 to 64 of the letters, digits, '_', '.' and '-', starting with a letter or digit")
    return text


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError("must be a finite number")
    return value


def _simple_polygon(ring: list[tuple[float, float]]) -> list[tuple[float, float]]:
    if len(ring) < 3:
        raise ValueError(f"a polygon needs at least 3 corners, this one has {len(ring)}")
    polygon = shapely.Polygon(ring)
    if not polygon.is_valid:
        raise ValueError(f"the polygon must not cross or touch itself ({shapely.is_valid_reason(polygon)})")
    if polygon.area <= 0.0:
        raise ValueError("the polygon encloses no area")
    return ring


def _inside_folder(path: Path, info: ValidationInfo) -> Path:
    """Read a path as the site file's author means it: relative to the file, with environment variables."""
    expanded = Path(expand_environment(str(path))).expanduser()
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


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Obstacle(_Part):
    """Something nobody stands in: an exhibit, a pillar, a counter."""

    id: Identifier
    polygon: Polygon


class Floor(_Part):
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


class Area(_Part):
    """What one fusion process tracks; an area lies on one floor."""

    id: Identifier
    floor: Identifier


class Source(_Part):
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


class TsaiGeometry(_Part):
    """A Tsai calibration file in XML."""

    kind: Literal["tsai"]
    file: SitePath

    def build(self) -> CameraGeometry:
        """Return the calibrated camera."""
        return CameraGeometry.from_tsai_file(self.file)


class PointsGeometry(_Part):
    """At least four pairs of a pixel and the place on the floor it shows."""

    kind: Literal["points"]
    image_size: ImageSize
    image: Annotated[list[Point], Field(min_length=4)]
    plan: Annotated[list[Point], Field(min_length=4)]

    def build(self) -> CameraGeometry:
        """Return the calibrated camera."""
        return CameraGeometry.from_points(self.image_size, np.array(self.image), np.array(self.plan))


class PoseGeometry(_Part):
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


class Camera(_Part):
    """One camera: its pictures, its geometry, and which part of its picture matters."""

    id: Identifier
    area: Identifier
    source: Source
    geometry: Annotated[TsaiGeometry | PointsGeometry | PoseGeometry, Field(discriminator="kind")]
    area_of_interest: Polygon | None = None
    """In pixels of the geometry's image size; feet outside it are ignored."""
    latency: Annotated[Number, Field(ge=0, le=10)] = 0.0
    """Seconds between the light and the arrival of the frame, for live sources."""


class AccessPoint(_Part):
    """A radio at a known place: its position, the addresses it transmits with, and a first guess of its strength."""

    id: Identifier
    floor: Identifier
    position: Point3
    addresses: list[str] = []
    kind: Literal["wifi", "ble"] = "wifi"
    power_1m: Annotated[Number, Field(ge=-110, le=0)] = -40.0
    """P₀: received power one metre away, dBm."""
    path_loss_exponent: Annotated[Number, Field(ge=1, le=6)] = 2.2


class Zone(_Part):
    """A polygon with a name whose crossings are told."""

    id: Identifier
    name: str = ""
    floor: Identifier
    polygon: Polygon
    alert_on: list[Literal["enter", "exit"]] = ["enter", "exit"]


class Site(_Part):
    """Everything the site file says."""

    format: Literal["atrium-site/1"]
    site: Identifier
    name: str = ""
    north: Annotated[Number, Field(ge=-360, le=360)] = 90.0
    """Direction of the compass's north on the plan, degrees counter-clockwise from the +x axis."""
    floors: Annotated[list[Floor], Field(min_length=1)]
    areas: Annotated[list[Area], Field(min_length=1)]
    cameras: list[Camera] = []
    access_points: list[AccessPoint] = []
    zones: list[Zone] = []

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


def load_site(path: str | Path) -> Site:
    """Read and check a site file.

    Raises:
        SiteError: the file is missing, is not YAML, or anything in it is wrong; all mistakes are named at once.
    """
    path = Path(path)
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SiteError(f"{path}: cannot be read: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise SiteError(f"{path}: not YAML: {error}") from error
    if not isinstance(document, dict):
        raise SiteError(
            f"{path}: must hold a mapping with 'format', 'site', 'floors' …, found {type(document).__name__}"
        )
    try:
        site = Site.model_validate(document, context={"folder": path.parent.resolve()})
    except ValidationError as error:
        raise SiteError(_explain(path, error)) from error
    problems = list(_cross_check(site))
    if problems:
        raise SiteError("\n".join(f"{path}: {problem}" for problem in problems))
    return site


P = TypeVar("P", Floor, Area, Camera)


def _by_id(parts: Sequence[P], wanted: str) -> P:
    for part in parts:
        if part.id == wanted:
            return part
    known = ", ".join(part.id for part in parts) or "none"
    raise KeyError(f"{wanted!r} is not in the site file; it has: {known}")


def _explain(path: Path, error: ValidationError) -> str:
    lines = []
    for problem in error.errors():
        place = ""
        for step in problem["loc"]:
            # pydantic puts the chosen variant of a tagged union into the path; the file has no such level.
            if step not in ("tsai", "points", "pose"):
                place += f"[{step}]" if isinstance(step, int) else f".{step}" if place else str(step)
        message = problem["msg"].removeprefix("Value error, ")
        value = problem["input"]
        shown = "" if isinstance(value, dict) or problem["type"] == "missing" else f" (found {_shorten(value)})"
        lines.append(f"{path}: {place or 'document'}: {message}{shown}")
    return "\n".join(lines)


def _shorten(value: object) -> str:
    text = repr(redact_url(value) if isinstance(value, str) else value)
    return text if len(text) <= 120 else text[:117] + "..."


def _cross_check(site: Site) -> Iterable[str]:
    """Yield what single fields cannot show: names used twice, names that lead nowhere, cameras that see no floor."""
    for name in ("floors", "areas", "cameras", "access_points", "zones"):
        counts = Counter(part.id for part in getattr(site, name))
        yield from (
            f"{name}: id {key!r} is used {count} times, ids must differ" for key, count in counts.items() if count > 1
        )
    addresses = Counter(address.lower() for point in site.access_points for address in point.addresses)
    for address, count in addresses.items():
        if count > 1:
            yield f"access_points: address {address!r} stands at {count} places; one address, one access point"
    floors = {floor.id for floor in site.floors}
    areas = {area.id for area in site.areas}
    for name in ("areas", "access_points", "zones"):
        for index, part in enumerate(getattr(site, name)):
            if part.floor not in floors:
                yield f"{name}[{index}].floor: {part.floor!r} is no floor; allowed: {', '.join(sorted(floors))}"
    for index, camera in enumerate(site.cameras):
        if camera.area not in areas:
            yield f"cameras[{index}].area: {camera.area!r} is no area; allowed: {', '.join(sorted(areas))}"
        try:
            geometry = camera.geometry.build()
        except GeometryError as error:
            yield f"cameras[{index}].geometry: {error}"
            continue
        width, height = geometry.image_size
        grid = np.stack(np.meshgrid(np.linspace(0, width - 1, 16), np.linspace(0, height - 1, 16)), axis=-1)
        if not np.isfinite(geometry.to_ground(grid.reshape(-1, 2))).any():
            yield f"cameras[{index}].geometry: no pixel of this camera sees the floor"
        for u, v in camera.area_of_interest or []:
            if not (0 <= u <= width and 0 <= v <= height):
                yield f"cameras[{index}].area_of_interest: ({u:g}, {v:g}) lies outside the {width} x {height} picture"
                break
