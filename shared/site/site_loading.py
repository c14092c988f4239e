"""Read a site file, and what was set up in the browser over it, and check it whole before anything starts.

Every mistake is one message that names the file, the path inside it, the value found and what is allowed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import shapely

from shared.part_file import PartFileError, read_part_file
from shared.site.camera_geometry import GeometryError
from shared.site.setup_file import SetUp, apply_setup, read_setup, setup_path
from shared.site.site_file import Site

__all__ = ["ON_FLOOR", "SiteError", "file_alone", "laid_over", "load_site", "site_problems"]


ON_FLOOR = 1.0
"""Metres outside a floor at which an exhibit may still hang on its wall."""


class SiteError(ValueError):
    """The site file cannot be used: the text names file, path inside it, value and what is allowed."""


def load_site(path: str | Path) -> Site:
    """Read and check a site file, and lay over it what was set up in the browser (``setup_file``).

    Raises:
        SiteError: a file is missing, is not YAML, or anything in it is wrong; all mistakes are named at once.
    """
    path = Path(path)
    site = file_alone(path)
    try:
        setup = read_setup(path)
    except PartFileError as error:
        raise SiteError(str(error)) from error
    return site if setup is None else laid_over(site, setup, path)


def file_alone(path: Path) -> Site:
    """Read and check a site file, whatever was set up in the browser.

    Raises:
        SiteError: as for ``load_site``.
    """
    try:
        site = read_part_file(path, Site)
    except PartFileError as error:
        raise SiteError(str(error)) from error
    return _checked(site, path, [])


def laid_over(site: Site, setup: SetUp, path: Path) -> Site:
    """Return the site of the file ``path`` with what was set up, checked whole.

    Raises:
        SiteError: the set-up does not fit the site.
    """
    over, problems = setup_path(path), list[str]()
    return _checked(apply_setup(site, setup, problems.append), over, problems)


def _checked(site: Site, path: Path, problems: list[str]) -> Site:
    told = [f"{path}: {problem}" for problem in (*problems, *site_problems(site))]
    if told:
        raise SiteError("\n".join(told))
    return site


def site_problems(site: Site) -> Iterable[str]:
    """Yield what single fields cannot show: names used twice, names that lead nowhere, cameras that see no floor."""
    for name in ("floors", "areas", "cameras", "access_points", "zones", "exhibits"):
        counts = Counter(part.id for part in getattr(site, name))
        yield from (
            f"{name}: id {key!r} is used {count} times, ids must differ" for key, count in counts.items() if count > 1
        )
    for field, what in (("addresses", "address"), ("receivers", "receiver")):
        owners: dict[str, list[str]] = {}
        for point in site.access_points:
            for name in getattr(point, field):
                owners.setdefault(name.strip().casefold(), []).append(point.id)
        for name, points in owners.items():
            if len(points) > 1:
                yield (
                    f"access_points: {what} {name!r} stands at {len(points)} places: {', '.join(points)}; "
                    f"one {what}, one access point"
                )
    for index, floor in enumerate(site.floors):
        for key, count in Counter(obstacle.id for obstacle in floor.obstacles).items():
            if count > 1:
                yield f"floors[{index}].obstacles: id {key!r} is used {count} times, ids must differ"
    floors = {floor.id for floor in site.floors}
    areas = {area.id for area in site.areas}
    for name in ("areas", "access_points", "zones", "exhibits"):
        for index, part in enumerate(getattr(site, name)):
            if part.floor not in floors:
                yield f"{name}[{index}].floor: {part.floor!r} is no floor; allowed: {', '.join(sorted(floors))}"
    for index, exhibit in enumerate(site.exhibits):
        outline = next((shapely.Polygon(floor.outline) for floor in site.floors if floor.id == exhibit.floor), None)
        if outline is not None and outline.distance(shapely.Point(exhibit.position)) > ON_FLOOR:
            x, y = exhibit.position
            yield f"exhibits[{index}].position: ({x:g}, {y:g}) lies nowhere on floor {exhibit.floor!r}"
    for index, camera in enumerate(site.cameras):
        if camera.area not in areas:
            yield f"cameras[{index}].area: {camera.area!r} is no area; allowed: {', '.join(sorted(areas))}"
        try:
            geometry = camera.geometry.build()
        except GeometryError as error:
            yield f"cameras[{index}].geometry: {error}"
            continue
        if geometry.position[2] <= 0.0:
            height = geometry.position[2]
            yield f"cameras[{index}].geometry: the camera hangs {height:.2f} m above its floor; allowed: > 0"
            continue
        width, height = geometry.image_size
        grid = np.stack(np.meshgrid(np.linspace(0, width - 1, 16), np.linspace(0, height - 1, 16)), axis=-1)
        if not np.isfinite(geometry.to_ground(grid.reshape(-1, 2))).any():
            yield f"cameras[{index}].geometry: no pixel of this camera sees the floor"
        for u, v in camera.area_of_interest or []:
            if not (0 <= u <= width and 0 <= v <= height):
                yield f"cameras[{index}].area_of_interest: ({u:g}, {v:g}) lies outside the {width} x {height} picture"
                break
