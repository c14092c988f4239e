"""Who learns: every learner of a site in its place, and who judges stretches. A new one is a line here."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from services.learning.area_judge import AreaJudge, AreaSight
from services.learning.area_tracks import AreaTracks
from services.learning.cameras.alignment import AlignmentLessons
from services.learning.cameras.detector_lessons import DetectorLessons
from services.learning.lesson import Lesson
from services.learning.maps.maps_learner import MapsLearner
from services.learning.proposal import Learner
from services.learning.radio.lessons import RadioLessons
from services.learning.tracks.assembler import StretchAssembler
from services.learning.walking.clock_lessons import ClockLessons
from services.learning.walking.heading_lessons import HeadingLessons
from services.learning.walking.stride_lessons import StrideLessons
from shared.site import Site
from shared.site.geometry_digest import geometry_digest

__all__ = ["Tools", "areas_of", "lessons_of"]


@dataclass(frozen=True)
class Tools:
    """What learners may ask for, each answered by another process; both may take minutes.

    Attributes:
        redetect: has a camera work its last minutes again with other detector options.
        rescore: has fusion of an area try a candidate.
        executor: where that is waited for.
        wait: waits some seconds, or until the process is told to stop.
    """

    redetect: Callable[[str, Mapping[str, float]], Mapping[str, Any]]
    rescore: Callable[[str, bytes], Mapping[str, Any]]
    executor: Executor
    wait: Callable[[float], object]


def areas_of(site: Site, areas: Sequence[str]) -> dict[str, AreaTracks]:
    """Return where the stretches of each area come from."""
    return {area: _tracks_of(site, area) for area in areas}


def lessons_of(site: Site, areas: Sequence[str], tools: Tools) -> list[Lesson]:
    """Return all learners, each in its place; phones' own are learned in all areas by one learner."""
    everywhere = frozenset(areas)
    lessons = [
        _lesson("stride", everywhere, lambda: StrideLessons(areas[0])),
        _lesson("heading", everywhere, lambda: HeadingLessons(areas[0])),
    ]
    for area in areas:
        lessons += _lessons_of_area(site, area, tools)
    return lessons


def _lessons_of_area(site: Site, area: str, tools: Tools) -> list[Lesson]:
    here = frozenset({area})
    cameras = site.cameras_of(area)
    names = [camera.id for camera in cameras]
    walkable = site.floor(site.area(area).floor).plan().walkable
    hangs = {camera.id: np.asarray(camera.geometry.build().position) for camera in cameras}
    calibrations = {camera.id: geometry_digest(camera.geometry) for camera in cameras}
    asked = tools.redetect, tools.rescore, tools.executor, tools.wait
    return [
        _lesson(f"radio/{area}", here, lambda: RadioLessons(site, area)),
        _lesson(f"detector/{area}", here, lambda: DetectorLessons(area, names, *asked)),
        _lesson(f"alignment/{area}", here, lambda: AlignmentLessons(area, walkable, hangs, calibrations)),
        _lesson(f"clocks/{area}", here, lambda: ClockLessons(area, names)),
        _lesson(f"maps/{area}", here, lambda: MapsLearner(site, area)),
    ]


def _lesson(name: str, areas: frozenset[str], make: Callable[[], Learner]) -> Lesson:
    return Lesson(name, make(), areas, make)


def _tracks_of(site: Site, area: str) -> AreaTracks:
    floor = site.area(area).floor
    points = [point.id for point in site.access_points if point.floor == floor]
    cameras = [camera.id for camera in site.cameras_of(area)]

    def make() -> AreaTracks:
        return AreaTracks(area, cameras, StretchAssembler(points), AreaJudge(site, area), AreaSight(site, area), make)

    return make()
