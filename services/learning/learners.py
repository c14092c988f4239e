"""Who learns: every learner of a site in its place, and who judges stretches. A new one is a line here."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from services.learning.area_judge import AreaJudge, AreaSight
from services.learning.area_tracks import AreaTracks
from services.learning.lesson import Lesson
from services.learning.maps.maps_learner import MapsLearner
from services.learning.tracks.assembler import StretchAssembler
from services.learning.walking.heading_lessons import HeadingLessons
from services.learning.walking.stride_lessons import StrideLessons
from shared.site import Site

__all__ = ["Tools", "areas_of", "lessons_of"]


@dataclass(frozen=True)
class Tools:
    """What learners may ask for, each answered by another process; both may take minutes.

    Attributes:
        redetect: has a camera work its last minutes again with other detector options.
        rescore: has fusion of an area try a candidate.
    """

    redetect: Callable[[str, Mapping[str, float]], Mapping[str, Any]]
    rescore: Callable[[str, bytes], Mapping[str, Any]]


def areas_of(site: Site, areas: Sequence[str]) -> dict[str, AreaTracks]:
    """Return where the stretches of each area come from."""
    return {area: _tracks_of(site, area) for area in areas}


def lessons_of(site: Site, areas: Sequence[str], tools: Tools) -> list[Lesson]:
    """Return all learners, each in its place; phones' own are learned in all areas by one learner."""
    everywhere = frozenset(areas)
    lessons = [
        Lesson("stride", StrideLessons(areas[0]), everywhere),
        Lesson("heading", HeadingLessons(areas[0]), everywhere),
    ]
    lessons += [Lesson(f"maps/{area}", MapsLearner(site, area), frozenset({area})) for area in areas]
    return lessons


def _tracks_of(site: Site, area: str) -> AreaTracks:
    floor = site.area(area).floor
    points = [point.id for point in site.access_points if point.floor == floor]
    cameras = [camera.id for camera in site.cameras_of(area)]
    return AreaTracks(area, cameras, StretchAssembler(points), AreaJudge(site, area), AreaSight(site, area))
