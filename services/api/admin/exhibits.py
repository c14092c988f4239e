"""What an exhibit is to the API, and whether one makes sense."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated

import msgspec
import shapely
from msgspec import Meta

from services.api.admin.zone_check import FARTHEST, check_floor
from services.api.request_body import invalid
from shared.site import Site
from shared.site.site_loading import ON_FLOOR
from shared.zones import Id

__all__ = ["MOST_EXHIBITS", "ExhibitDefinition", "check_exhibit", "exhibits_of"]

MOST_EXHIBITS = 5000


class ExhibitDefinition(msgspec.Struct, frozen=True, kw_only=True):
    """Something to look at: where it stands or hangs, and from how far and from where it is looked at."""

    id: Id
    name: Annotated[str, Meta(max_length=200)] = ""
    floor: Id
    x: float
    y: float
    reach: Annotated[float, Meta(gt=0.0, le=100.0)] = 8.0
    """Metres from which it is looked at, at most."""
    facing: Annotated[float, Meta(ge=-360.0, le=360.0)] | None = None
    """Where its front looks, degrees counter-clockwise from the plan's +x; null: it has no back."""


def exhibits_of(site: Site) -> list[ExhibitDefinition]:
    """Return the exhibits of a site file."""
    return [
        ExhibitDefinition(
            id=one.id,
            name=one.name,
            floor=one.floor,
            x=one.position[0],
            y=one.position[1],
            reach=one.reach,
            facing=one.facing,
        )
        for one in site.exhibits
    ]


def check_exhibit(exhibit: ExhibitDefinition, floors: Mapping[str, shapely.Polygon]) -> None:
    """Accept an exhibit.

    Raises:
        ProblemError: the floor is not known, or it stands nowhere on it.
    """
    outline = check_floor(exhibit.floor, floors)
    for field, value in (("x", exhibit.x), ("y", exhibit.y)):
        if not math.isfinite(value) or abs(value) > FARTHEST:
            raise invalid(field, f"{value:g}", f"metres on the plan, at most {FARTHEST:g} from its zero")
    if outline.distance(shapely.Point(exhibit.x, exhibit.y)) > ON_FLOOR:
        raise invalid("x, y", f"{exhibit.x:g}, {exhibit.y:g}", f"a place on floor {exhibit.floor}")
