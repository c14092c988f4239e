"""Read a scenario file with its site and check them against each other before anything starts.

Every mistake is one line that names the file, the place inside it, the value found and what is allowed.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from services.simulator.faults import unknown_phones
from services.simulator.people import People
from services.simulator.radio.radio_changes import far_away, unknown_names
from services.simulator.scenario_file import FileView, RecordedPeople, Scenario
from services.simulator.world import cameras_of, carriers_of, people_of
from shared.part_file import PartFileError, read_part_file
from shared.site import Camera, Site, SiteError
from shared.site.camera_geometry import GeometryError
from shared.site.site_loading import file_alone

__all__ = ["ScenarioError", "load_scenario", "scenario_digest", "seen_floor", "watched"]

LEAST_SEEN = 0.5
"""m² of walkable floor that a camera must see."""
FARTHEST = 60.0
"""Metres; nobody farther from a camera is seen."""
CELL = 0.2
ROWS = 500
"""Times of a recorded file that are looked at together."""


class ScenarioError(ValueError):
    """The scenario cannot be used: the text names file, path inside it, value and what is allowed."""


def load_scenario(path: str | Path, site_file: Path | None = None) -> tuple[Scenario, Site]:
    """Read and check a scenario and its site.

    Args:
        path: the scenario file.
        site_file: the site to use; None: the one the scenario names.

    Raises:
        ScenarioError: anything is wrong with either; all contradictions are named at once.
    """
    path = Path(path)
    try:
        scenario = read_part_file(path, Scenario)
        # The world is as the site file says; what is set up in the browser is what Atrium takes it to be.
        site = file_alone(Path(site_file or scenario.site))
    except (PartFileError, SiteError) as error:
        raise ScenarioError(str(error)) from error
    problems = list(_cross_check(scenario, site))
    if problems:
        raise ScenarioError("\n".join(f"{path}: {problem}" for problem in problems))
    try:
        people = people_of(scenario, site, scenario.seeds.test)
    except ValueError as error:
        raise ScenarioError(f"{path}: people: {error}") from error
    if isinstance(scenario.people, RecordedPeople):
        problem = _never_there(scenario.people, scenario.duration, site, people)
        if problem is not None:
            raise ScenarioError(f"{path}: people.file: {problem}")
    wanted = sum(fleet.count for fleet in scenario.phones)
    if wanted > len(people.persons):
        raise ScenarioError(
            f"{path}: phones: {wanted} phones for {len(people.persons)} people; everybody carries one at most"
        )
    carrying = [carrier.person for carrier in carriers_of(scenario, people)]
    problems = list(unknown_phones(scenario.faults, carrying))
    if problems:
        raise ScenarioError("\n".join(f"{path}: {problem}" for problem in problems))
    return scenario, site


LEFT_OUT = ("source", "about", "name", "time_zone", "anchor", "exhibits")
"""Addresses of pictures, prose, where on Earth it is, what guides tell of (people walk about obstacles): none of it
matters to what a scenario plays."""


def scenario_digest(scenario: Scenario, site: Site) -> str:
    """Return a hash of all that scenario and site say, defaults included: when it changes, results do not compare."""
    content = {"scenario": _portable(scenario.model_dump(mode="json")), "site": _portable(site.model_dump(mode="json"))}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _portable(value: Any, key: str = "") -> Any:
    """Drop what differs between machines or tells nothing about the world, see ``LEFT_OUT``; of folders too."""
    if isinstance(value, dict):
        return {name: _portable(part, name) for name, part in value.items() if name not in LEFT_OUT}
    if isinstance(value, list):
        return [_portable(part, key) for part in value]
    return Path(value).name if key in ("file", "site") and isinstance(value, str) else value


def seen_floor(camera: Camera, site: Site) -> NDArray[np.float64]:
    """Return what a camera watches as the middles (n, 2) of ``CELL``-sized squares of its floor.

    That is inside the picture, the area of interest, the outline and ``FARTHEST``, obstacles or not.
    """
    geometry = camera.geometry.build()
    outline = shapely.Polygon(site.floor(site.area(camera.area).floor).outline)
    west, south, east, north = outline.bounds
    x, y = np.meshgrid(np.arange(west + 0.5 * CELL, east, CELL), np.arange(south + 0.5 * CELL, north, CELL))
    points = np.column_stack([x.ravel(), y.ravel()])
    points = points[shapely.intersects_xy(outline, points[:, 0], points[:, 1])]
    near = np.hypot(*(points - geometry.position[:2]).T) <= FARTHEST
    chosen: NDArray[np.float64] = points[near & watched(camera, points)]
    return chosen


def watched(camera: Camera, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether a camera looks at each of the floor points (n, 2), hidden or not; NaN points are not looked at."""
    geometry = camera.geometry.build()
    pixels = geometry.to_image(np.column_stack([points, np.zeros(len(points))]))
    width, height = geometry.image_size
    with np.errstate(invalid="ignore"):
        seen = np.asarray(((pixels >= -0.5) & (pixels <= np.array([width, height]) - 0.5)).all(axis=1))
    if camera.area_of_interest is not None:
        seen[seen] = shapely.intersects_xy(shapely.Polygon(camera.area_of_interest), pixels[seen, 0], pixels[seen, 1])
    return seen


def _cross_check(scenario: Scenario, site: Site) -> Iterator[str]:
    yield from _walls_through_exhibits(site)
    yield from _views(scenario, site)
    yield from _people(scenario, site)
    yield from _phones(scenario, site)
    yield from _changes(scenario, site)
    yield from _faults(scenario, site)


def _walls_through_exhibits(site: Site) -> Iterator[str]:
    for f, floor in enumerate(site.floors):
        for w, wall in enumerate(floor.walls):
            line = shapely.LineString(wall)
            for obstacle in floor.obstacles:
                if shapely.length(shapely.intersection(line, shapely.Polygon(obstacle.polygon).buffer(-0.02))) > 0.0:
                    yield (
                        f"site {site.site}: floors[{f}].walls[{w}]: the wall runs through obstacle {obstacle.id!r}; "
                        "walls and obstacles may touch but not cross"
                    )


def _views(scenario: Scenario, site: Site) -> Iterator[str]:
    known = [camera.id for camera in site.cameras]
    told: Counter[str] = Counter()
    for number, view in enumerate(scenario.views):
        if not known:
            yield f"views[{number}]: site {site.site} has no camera"
            continue
        if view.camera != "*" and view.camera not in known:
            yield f"views[{number}].camera: {view.camera!r} is no camera; allowed: {', '.join(known)} or '*'"
            continue
        if isinstance(view, FileView) and not view.file.is_file():
            yield f"views[{number}].file: {view.file} does not exist"
        for camera in cameras_of(view.camera, site):
            told[camera.id] += 1
            try:
                area = CELL**2 * len(seen_floor(camera, site))
            except GeometryError as error:
                yield f"views[{number}]: camera {camera.id}: {error}"
                continue
            if area < LEAST_SEEN:
                yield (
                    f"views[{number}]: camera {camera.id} sees {area:.2f} m² of floor {site.area(camera.area).floor}; "
                    f"allowed: {LEAST_SEEN} or more"
                )
    yield from (
        f"views: camera {name} is described {count} times; once is allowed" for name, count in told.items() if count > 1
    )


def _people(scenario: Scenario, site: Site) -> Iterator[str]:
    chosen = scenario.people
    floors = [floor.id for floor in site.floors]
    if isinstance(chosen, RecordedPeople):
        if chosen.floor is not None and chosen.floor not in floors:
            yield f"people.floor: {chosen.floor!r} is no floor; allowed: {', '.join(floors)}"
        if chosen.camera is not None and chosen.camera not in (known := [camera.id for camera in site.cameras]):
            yield f"people.camera: {chosen.camera!r} is no camera; allowed: {', '.join(known)}"
        return
    wanted, most = sum(fleet.count for fleet in scenario.phones), chosen.walkers.present[1]
    if wanted > most:
        yield f"phones: {wanted} phones, but people.walkers.present lets {most} people in at most; one phone for each"
    for number, door in enumerate(chosen.walkers.doors):
        if door.floor not in floors:
            yield f"people.walkers.doors[{number}].floor: {door.floor!r} is no floor; allowed: {', '.join(floors)}"


def _never_there(recorded: RecordedPeople, duration: float, site: Site, people: People) -> str | None:
    """Return why nobody of a recorded file would ever be on the floor; None where somebody is."""
    rows = people.instants(-np.inf, np.inf)
    times = rows[(rows >= 0.0) & (rows <= duration)]
    if not len(times):
        return (
            f"the rows of {recorded.file.name} lie from {rows[0]:g} to {rows[-1]:g} s; "
            f"allowed: some from 0 to the duration, {duration:g} s"
        )
    floor = site.floor(people.floors[0])
    outline = shapely.Polygon(floor.outline)
    nearest = np.inf
    for first in range(0, len(times), ROWS):
        moved = people.movement(times[first : first + ROWS])
        nearest = min(
            nearest, shapely.distance(outline, shapely.points(moved.position[moved.present])).min(initial=np.inf)
        )
        if nearest == 0.0:
            return None
    return (
        f"nobody in {recorded.file.name} is ever on floor {floor.id}, the nearest row is {nearest:.1f} m outside its "
        "outline; allowed: positions in metres on the site's plan"
    )


def _phones(scenario: Scenario, site: Site) -> Iterator[str]:
    names = Counter(fleet.name for fleet in scenario.phones)
    yield from (f"phones: the name {name!r} is used {count} times" for name, count in names.items() if count > 1)
    nowhere = [point.id for point in site.access_points if point.position is None]
    if scenario.phones and nowhere:
        yield (
            f"phones: site {site.site} does not say where access point {nowhere[0]} hangs; allowed: sites that give a "
            "position to each, for what phones hear is made of it"
        )
    kinds = {point.kind for point in site.access_points}
    named = {point.kind for point in site.access_points if point.addresses}
    for number, fleet in enumerate(scenario.phones):
        for kind in sorted(set(fleet.hears) - kinds):
            has = ", ".join(sorted(kinds)) or "none"
            yield f"phones[{number}].{kind}: nobody here sends {kind}; access points of site {site.site}: {has}"
        for kind in sorted(set(fleet.hears) & kinds - named):
            yield (
                f"phones[{number}].{kind}: phones would hear nobody: addresses is empty for every {kind} access point "
                f"of site {site.site}; allowed: one or more"
            )


def _changes(scenario: Scenario, site: Site) -> Iterator[str]:
    changes = scenario.radio.changes
    yield from (f"radio.{problem}" for problem in [*unknown_names(changes, site), *far_away(changes, site)])


def _faults(scenario: Scenario, site: Site) -> Iterator[str]:
    cameras = [camera.id for camera in site.cameras]
    for number, fault in enumerate(scenario.faults):
        camera = getattr(fault, "camera", None)
        if camera not in (None, "*") and camera not in cameras:
            known = ", ".join(cameras) or "none"
            yield f"faults[{number}].camera: {camera!r} is no camera; allowed: {known}, or '*' for all"
