"""``/v1/learning/maps``: what was learned of places, as numbers and as pictures."""

from __future__ import annotations

from typing import Annotated, Any, cast, get_args

import msgspec
from fastapi import APIRouter, Query
from starlette.responses import Response

from services.api.learning_link import LearningLink
from services.api.map_picture import map_svg
from services.api.openapi import documented, errors
from services.api.problems import Problem, ProblemError, unknown
from shared.learning_command import MapKind
from shared.learning_report import MapGrid
from shared.site import Site

__all__ = ["learning_maps"]

MAP_KINDS: tuple[str, ...] = get_args(MapKind)
OfPoint = Annotated[str | None, Query(description="whose map, for radio and shadowing")]

_PICTURE: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The map drawn on the floor plan, with its legend.",
        "content": {
            "image/svg+xml": {
                "schema": {"type": "string"},
                "example": '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 960 640"></svg>',
            }
        },
    }
}


def learning_maps(site: Site, link: LearningLink) -> APIRouter:
    """Return the routes of the maps; ``site`` is there to check ids and to draw on its floors."""
    router = APIRouter(prefix="/v1/learning/maps", tags=["learning"], default_response_class=Response)
    areas = [area.id for area in site.areas]

    def grid(area: str, kind: str, access_point: str | None) -> MapGrid:
        if area not in areas:
            raise unknown("area", area, areas)
        if kind not in MAP_KINDS:
            raise unknown("map", kind, list(MAP_KINDS))
        points = [point.id for point in site.access_points if point.floor == site.area(area).floor]
        of_point = kind in ("radio", "shadowing")
        if of_point and access_point not in points:
            raise unknown("access_point", "" if access_point is None else access_point, points)
        found = link.map(area, cast(MapKind, kind), access_point if of_point else None)
        if found.map is None:
            raise ProblemError(
                Problem(
                    type="urn:atrium:nothing-learned",
                    title="Nothing learned yet",
                    status=404,
                    detail=found.words or "nothing is known for this map yet: it fills as people walk",
                )
            )
        return found.map

    @router.get("/{area}/{kind}.svg", responses=_PICTURE | errors(404, 503))
    def picture(area: str, kind: str, access_point: OfPoint = None) -> Response:
        """A learned map as a picture, drawn on the floor plan."""
        found = grid(area, kind, access_point)
        floor = site.floor(site.area(area).floor)
        drawn = map_svg(found, floor, [point for point in site.access_points if point.floor == floor.id])
        return Response(drawn, media_type="image/svg+xml", headers={"Cache-Control": "no-store"})

    @router.get("/{area}/{kind}", responses=documented(MapGrid, 404, 503))
    def numbers(area: str, kind: str, access_point: OfPoint = None) -> Response:
        """A learned map as a grid: visits, occlusion, radio, shadowing or magnetic."""
        return Response(msgspec.json.encode(grid(area, kind, access_point)), media_type="application/json")

    return router
