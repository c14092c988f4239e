"""What changes in the radio while a world runs: a wall is built, an access point moves or changes its power."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from shared.site.site_file import Identifier, Number, Part, Point, Point3, Site

__all__ = ["MovedAccessPoint", "NewWall", "PowerChange", "RadioChange", "unknown_names"]

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
