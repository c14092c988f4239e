"""What does a map need to know of the site? Everything drawn on the floor, nothing about where pictures come from."""

from __future__ import annotations

from collections.abc import Sequence

from services.api.replies import (
    AccessPointView,
    AreaView,
    CameraView,
    FloorView,
    ObstacleView,
    SiteView,
    ZoneView,
)
from shared.site import Camera, Site
from shared.site.footprint import footprint
from shared.zones import ZoneDefinition

__all__ = ["site_view", "zone_view"]


def site_view(site: Site, zones: Sequence[ZoneDefinition]) -> SiteView:
    """Return the part of the site file that a map shows, with the zones as staff keep them."""
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
        zones=[zone_view(zone) for zone in zones],
    )


def zone_view(zone: ZoneDefinition) -> ZoneView:
    """Return what a map shows of a zone."""
    return ZoneView(id=zone.id, name=zone.name, floor=zone.floor, polygon=zone.points, shape=zone.shape)


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
