"""What changes in the radio while a world runs: a wall is built, an access point moves or changes its power."""

from __future__ import annotations

from typing import Annotated, Literal

import shapely
from pydantic import Field, model_validator

from shared.site.site_file import Identifier, Number, Part, Point, Point3, Site

__all__ = ["MovedAccessPoint", "NewWall", "PowerChange", "RadioChange", "far_away", "unknown_names"]

AROUND = 20.0
"""Metres around a floor's outline where walls and access points still matter to it."""

Time = Annotated[Number, Field(ge=0, le=1e7, description="seconds since the world began")]


class NewWall(Part):
    """A wall (or a rack, a lorry, a stage) stands there from then on, for radio only: people and cameras ignore it."""

    at: Time
    kind: Literal["wall"]
    line: Annotated[list[Point], Field(min_length=2, description="its corners on the plan, metres")]
    floor: Identifier
    loss: Annotated[Number, Field(ge=0, le=60, description="dB lost on a line that crosses it")] = 6.0

    @model_validator(mode="after")
    def _has_a_length(self) -> NewWall:
        if len(set(self.line)) < 2:
            raise ValueError("line: its corners are all one point; a wall needs two that differ")
        return self


class MovedAccessPoint(Part):
    """Somebody hangs an access point elsewhere on its floor; nobody tells the site file."""

    at: Time
    kind: Literal["moved"]
    access_point: Identifier
    position: Annotated[Point3, Field(description="x, y on the plan and height above the floor, metres")]


class PowerChange(Part):
    """An access point sends stronger or weaker from then on."""

    at: Time
    kind: Literal["power"]
    access_point: Identifier
    by: Annotated[Number, Field(ge=-60, le=60, description="dB")]


RadioChange = Annotated[NewWall | MovedAccessPoint | PowerChange, Field(discriminator="kind")]


def unknown_names(changes: list[RadioChange], site: Site) -> list[str]:
    """Return one message for each floor or access point of ``changes`` that the site does not have."""
    floors = [floor.id for floor in site.floors]
    points = [point.id for point in site.access_points]
    found = []
    for index, change in enumerate(changes):
        if isinstance(change, NewWall):
            key, name, known = "floor", change.floor, floors
        else:
            key, name, known = "access_point", change.access_point, points
        if name not in known:
            allowed = ", ".join(known) or "none"
            found.append(f"changes[{index}].{key}: {name!r} is not in the site file; it has: {allowed}")
    return found


def far_away(changes: list[RadioChange], site: Site) -> list[str]:
    """Return one message for each of ``changes`` that is too far from its floor; unknown names are passed over."""
    outlines = {floor.id: shapely.Polygon(floor.outline) for floor in site.floors}
    floors = {point.id: point.floor for point in site.access_points}
    found = []
    for index, change in enumerate(changes):
        places: list[tuple[str, tuple[float, ...]]]
        if isinstance(change, NewWall):
            floor, places = change.floor, [(f"line[{n}]", corner) for n, corner in enumerate(change.line)]
        elif isinstance(change, MovedAccessPoint):
            floor, places = floors.get(change.access_point, ""), [("position", change.position)]
        else:
            continue
        for key, place in places if floor in outlines else []:
            away = outlines[floor].distance(shapely.Point(place[:2]))
            if away > AROUND:
                found.append(
                    f"changes[{index}].{key}: {list(place)} is {away:.1f} m outside the outline of floor {floor}; "
                    f"allowed: up to {AROUND:g} m"
                )
                break
    return found
