"""Which part of the floor does a camera watch?"""

from __future__ import annotations

import numpy as np
import shapely

from shared.site.camera_geometry import CameraGeometry

__all__ = ["Ring", "footprint"]

Ring = list[tuple[float, float]]


def footprint(geometry: CameraGeometry, area_of_interest: Ring | None, outline: shapely.Polygon) -> Ring:
    """Return the part of the floor inside ``outline`` that the camera watches, as one ring of (x, y) metres.

    Args:
        geometry: the calibrated camera.
        area_of_interest: polygon in its pixels; None for the whole picture.
        outline: where people can be.

    The border of the watched pixels is projected to the floor. Where it looks at or above the horizon, or farther
    than anything in the outline, it is lowered within its own pixel column until it does not.
    """
    width, height = geometry.image_size
    corners = area_of_interest or [(0.0, 0.0), (width - 1.0, 0.0), (width - 1.0, height - 1.0), (0.0, height - 1.0)]
    border = shapely.get_coordinates(shapely.segmentize(shapely.Polygon(corners).exterior, max(width, height) / 48.0))
    eye = shapely.Point(geometry.position[:2])
    reach = 1.05 * float(shapely.hausdorff_distance(eye, outline.exterior)) + 1.0
    share = np.linspace(0.0, 1.0, 129)
    rows = border[:, 1, None] + (height - 1.0 - border[:, 1, None]) * share
    candidates = np.stack([np.broadcast_to(border[:, :1], rows.shape), rows], axis=-1)
    ground = geometry.to_ground(candidates.reshape(-1, 2)).reshape(*rows.shape, 2)
    with np.errstate(invalid="ignore"):
        near = np.linalg.norm(ground - geometry.position[:2], axis=-1) <= reach
    seen = near.any(axis=1)
    ring = ground[np.flatnonzero(seen), near.argmax(axis=1)[seen]]
    if len(ring) < 3:
        return []
    watched = shapely.intersection(shapely.make_valid(shapely.Polygon(ring)), outline)
    parts = [part for part in shapely.get_parts(watched) if isinstance(part, shapely.Polygon)]
    if not parts:
        return []
    largest = shapely.simplify(max(parts, key=lambda part: float(part.area)), 0.02)
    return [(round(float(x), 3), round(float(y), 3)) for x, y in shapely.get_coordinates(largest.exterior)[:-1]]
