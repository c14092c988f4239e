"""What was set up in the browser: calibrations, areas of interest and places of access points, in a file of its own.

The site file is written by people, with comments and variables that no program should rewrite. So what the dashboard
saves lies beside it, ``site.setup.yaml`` for ``site.yaml``, and goes over what the site file says. It is replaced as a
whole; the last versions are kept beside it as ``site.setup.N.yaml``.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import Field

from shared.part_file import Part, read_part_file
from shared.site.site_file import Identifier, Lens, Number, Point3, PointsGeometry, Polygon, Site

__all__ = ["CameraSetup", "PointPlace", "SetUp", "apply_setup", "read_setup", "save_setup", "setup_path"]

KEPT = 20
"""Earlier versions that are kept."""


class CameraSetup(Part):
    """One camera as it was calibrated in the browser; what is not given stays as the site file says."""

    geometry: PointsGeometry | None = None
    area_of_interest: Polygon | None = None
    whole_picture: bool = False
    """Whether feet count anywhere in the picture, whatever the site file says."""
    lens: Lens | None = None
    """As ``atrium calibrate-lens`` found it; calibrations saved from then on contain it."""
    saved: Annotated[Number, Field(ge=0)] = 0.0
    """When, seconds since the epoch."""
    by: str = ""
    """Name of the key it was saved with."""


class PointPlace(Part):
    """Where an access point hangs."""

    position: Point3
    saved: Annotated[Number, Field(ge=0)] = 0.0
    by: str = ""


class SetUp(Part):
    """The whole file."""

    format: Literal["atrium-setup/1"] = "atrium-setup/1"
    site: Identifier
    version: Annotated[int, Field(ge=0)] = 0
    cameras: dict[str, CameraSetup] = {}
    access_points: dict[str, PointPlace] = {}


def setup_path(site_file: Path) -> Path:
    """Return where the set-up of a site file lies."""
    return site_file.with_name(f"{site_file.stem}.setup.yaml")


def read_setup(site_file: Path) -> SetUp | None:
    """Return what was set up for a site, None where nothing was.

    Raises:
        PartFileError: the file is there and cannot be used; the text names file, place, value and what is allowed.
    """
    path = setup_path(site_file)
    return read_part_file(path, SetUp) if path.exists() else None


def apply_setup(site: Site, setup: SetUp, problem: Callable[[str], None]) -> Site:
    """Return the site with what was set up in place of what its file says.

    Args:
        site: as its file says.
        setup: goes over it.
        problem: told of what fits no part of the site.
    """
    if setup.site != site.site:
        problem(f"site: {setup.site!r} is another site; allowed: {site.site!r}")
        return site
    for name, given, known in (
        ("cameras", setup.cameras, [camera.id for camera in site.cameras]),
        ("access_points", setup.access_points, [point.id for point in site.access_points]),
    ):
        for key in given:
            if key not in known:
                allowed = ", ".join(known) or "none"
                problem(f"{name}.{key}: the site file has none of this name; allowed: {allowed}; take it out here")
    cameras = []
    for camera in site.cameras:
        changes: dict[str, Any] = {}
        if (found := setup.cameras.get(camera.id)) is not None:
            if found.geometry is not None:
                changes["geometry"] = found.geometry
            if found.area_of_interest is not None or found.whole_picture:
                changes["area_of_interest"] = found.area_of_interest
        cameras.append(camera.model_copy(update=changes))
    points = [
        point.model_copy(update={"position": setup.access_points[point.id].position})
        if point.id in setup.access_points
        else point
        for point in site.access_points
    ]
    return site.model_copy(update={"cameras": cameras, "access_points": points})


def save_setup(site_file: Path, setup: SetUp) -> None:
    """Replace the file as a whole and keep the one before.

    Raises:
        OSError: the folder cannot be written; nothing changed.
    """
    path = setup_path(site_file)
    text = (
        "# Written by Atrium: what was set up in the browser. Goes over what the site file says; docs/camera-setup.md\n"
    )
    text += yaml.safe_dump(setup.model_dump(mode="json", exclude_defaults=True) | {"format": setup.format}, width=120)
    part = path.with_name(f"{path.name}.part")
    with part.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    if path.exists():
        _earlier(path, setup.version - 1).unlink(missing_ok=True)
        _earlier(path, setup.version - 1).hardlink_to(path)
    part.replace(path)
    _earlier(path, setup.version - 1 - KEPT).unlink(missing_ok=True)


def _earlier(path: Path, version: int) -> Path:
    return path.with_name(f"{path.stem}.{version}.yaml")
