"""Where do people stand who look at an exhibit? One area for each, so that staying there can be counted.

The disc around it, as far as its reach and at most ``NEAR``; of it what lies on the floor, before its front, on its
side of walls, and nearer to it than to any other exhibit: nobody is counted at two.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from services.api.admin.exhibits import ExhibitDefinition
from services.api.in_front import BEHIND
from shared.site import FloorPlan
from shared.zones import ZoneDefinition

__all__ = ["NEAR", "viewing_places"]

NEAR = 3.0
"""Metres: who stands farther away passes by."""
WALL = 0.02
"""Metres that a wall takes on either side."""
SAME = 0.01
"""Metres: exhibits nearer to each other than this share their place."""
SMALLEST = 0.01
"""Square metres."""


def viewing_places(exhibits: Sequence[ExhibitDefinition], floor: str, plan: FloorPlan) -> list[ZoneDefinition]:
    """Return the areas of the exhibits of one floor, under their ids; none for one that nobody can stand before.

    Args:
        exhibits: of any floor.
        floor: which.
        plan: of that floor.
    """
    here = [exhibit for exhibit in exhibits if exhibit.floor == floor]
    at = np.array([(exhibit.x, exhibit.y) for exhibit in here], dtype=float).reshape(-1, 2)
    walls = plan.walls.buffer(WALL, cap_style="flat", join_style="mitre")
    places = []
    for number, exhibit in enumerate(here):
        reached: BaseGeometry = _disc(exhibit).intersection(plan.outline).difference(walls)
        seen: BaseGeometry = _this_side(exhibit, reached, plan)
        others = at[(np.hypot(*(at - at[number]).T) > SAME) & (np.hypot(*(at - at[number]).T) < 2.0 * NEAR)]
        for other in others:
            seen = seen.intersection(_nearer(at[number], other))
        largest = max(_parts(seen), key=lambda part: part.area, default=shapely.Polygon())
        if largest.area > SMALLEST:
            ring = [(round(x, 3), round(y, 3)) for x, y in largest.exterior.simplify(0.01).coords[:-1]]
            places.append(ZoneDefinition(id=exhibit.id, name=exhibit.name, floor=floor, points=ring))
    return places


def _disc(exhibit: ExhibitDefinition) -> shapely.Polygon:
    """What is within reach, of an exhibit with a front only what is before it."""
    radius = min(exhibit.reach, NEAR)
    middle, width = (0.0, np.pi) if exhibit.facing is None else (np.radians(exhibit.facing), BEHIND)
    angles = np.linspace(middle - width, middle + width, 65)
    rim = np.column_stack([exhibit.x + radius * np.cos(angles), exhibit.y + radius * np.sin(angles)]).tolist()
    return shapely.Polygon(rim[:-1] if exhibit.facing is None else [*rim, (exhibit.x, exhibit.y)])


def _this_side(exhibit: ExhibitDefinition, reached: BaseGeometry, plan: FloorPlan) -> BaseGeometry:
    """Keep the part on the exhibit's side of walls; of what hangs on a wall itself, the largest part beside it."""
    parts = _parts(reached)
    if len(parts) < 2:
        return reached
    at = shapely.Point(exhibit.x, exhibit.y)
    if plan.walls.distance(at) > 2.0 * WALL:
        return min(parts, key=lambda part: part.distance(at))
    return max(parts, key=lambda part: part.area if part.distance(at) < 4.0 * WALL else 0.0)


def _nearer(to: NDArray[np.float64], other: NDArray[np.float64]) -> shapely.Polygon:
    """Return, as far as it matters, the half of the plane that is nearer to one place than to the other."""
    along = (other - to) / np.hypot(*(other - to))
    across = np.array([-along[1], along[0]]) * 4.0 * NEAR
    middle, back = (to + other) / 2.0, along * 4.0 * NEAR
    return shapely.Polygon([middle - across, middle + across, middle + across - back, middle - across - back])


def _parts(shape: BaseGeometry) -> list[shapely.Polygon]:
    return [part for part in shapely.get_parts(shape) if isinstance(part, shapely.Polygon)]
