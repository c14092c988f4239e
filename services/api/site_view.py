"""What does a map need to know of the site? Everything drawn on the floor, nothing about where pictures come from."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from services.api.replies import (
    AccessPointView,
    AreaView,
    CameraView,
    FloorView,
    ObstacleView,
    Ring,
    SiteView,
    ZoneView,
)
from shared.site import Camera, CameraGeometry, Site

__all__ = ["footprint", "site_view"]

Array = NDArray[np.float64]


def site_view(site: Site) -> SiteView:
    """Return the part of the site file that a map shows."""
    return SiteView(
        site=site.site,
        name=site.name,
        north=site.north,
        floors=[
            FloorView(
                id=floor.id,
                name=floor.name,
                level=floor.level,
                outline=floor.outline,
                walls=floor.walls,
                obstacles=[ObstacleView(id=part.id, polygon=part.polygon) for part in floor.obstacles],
            )
            for floor in site.floors
        ],
        areas=[AreaView(id=area.id, floor=area.floor) for area in site.areas],
        cameras=[_camera_view(site, camera) for camera in site.cameras],
        access_points=[
            AccessPointView(id=point.id, floor=point.floor, position=point.position, kind=point.kind)
            for point in site.access_points
        ],
        zones=[ZoneView(id=zone.id, name=zone.name, floor=zone.floor, polygon=zone.polygon) for zone in site.zones],
    )


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


def _camera_view(site: Site, camera: Camera) -> CameraView:
    floor = site.floor(site.area(camera.area).floor)
    geometry = camera.geometry.build()
    x, y, z = (round(float(value), 3) for value in geometry.position)
    return CameraView(
        id=camera.id,
        area=camera.area,
        floor=floor.id,
        position=(x, y, z),
        footprint=footprint(geometry, camera.area_of_interest, floor.plan().outline),
    )
