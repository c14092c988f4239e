"""What people do in a simulated space: the scenario's ``walkers`` part.

Ranges are [low, high], seconds and metres per second; how each is drawn is said at the field.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from shared.site.site_file import Identifier, Number, Part, Point

__all__ = ["Behaviour", "Door", "WalkerParameters"]

Behaviour = Literal["visitors", "workers", "passers"]


def _ordered(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise ValueError(f"a range is [low, high], found [{pair[0]:g}, {pair[1]:g}]")
    return pair


def _ordered_counts(pair: tuple[int, int]) -> tuple[int, int]:
    _ordered(pair)
    return pair


_Count = Annotated[int, Field(ge=0, le=2000)]


class Door(Part):
    """Where people appear and leave: a way out of the outline, or stairs, an escalator, a lift to another floor."""

    id: Identifier
    floor: Identifier
    position: Point = Field(
        description="Middle of the opening, metres; within 0.6 m of the outline it leads out, else it needs leads_to."
    )
    width: Number = Field(1.6, ge=0.8, le=30, description="Metres; walls are open for as much.")
    leads_to: Identifier | None = Field(None, description="Door (of another floor) where who goes in here comes out.")
    seconds: Number = Field(15.0, ge=0, le=600, description="Time between the two doors, within 20 %.")


class WalkerParameters(Part):
    """Who walks, and how."""

    behaviour: Behaviour = Field(
        "visitors", description="Look at exhibits, work at stations, or cross to another door."
    )
    pool: int = Field(20, ge=1, le=2000, description="How many different people there are: person-1, person-2, …")
    present: Annotated[tuple[_Count, _Count], AfterValidator(_ordered_counts)] = Field(
        (8, 12), description="How many are inside at a time, all floors together; the number wanders in between."
    )
    carriers: int = Field(
        0, ge=0, le=2000, description="The first so many of the pool are inside most of the time (they carry phones)."
    )
    speed: Annotated[tuple[Number, Number], AfterValidator(_ordered)] = Field(
        (0.5, 1.3), description="A person's usual speed, m/s: normal about the middle, cut off at the ends."
    )
    dwell: Annotated[tuple[Number, Number], AfterValidator(_ordered)] = Field(
        (3.0, 45.0), description="Stay at one place, s: log-uniform, so few stay long."
    )
    visit: Annotated[tuple[Number, Number], AfterValidator(_ordered)] = Field(
        (240.0, 1200.0), description="Time inside after which a person would rather leave, s; uniform."
    )
    away: Annotated[tuple[Number, Number], AfterValidator(_ordered)] = Field(
        (40.0, 180.0), description="Time outside before a person may come again, s; uniform."
    )
    groups: Number = Field(0.35, ge=0, le=1, description="Share of arrivals that come as a group.")
    group_size: Annotated[
        tuple[Annotated[int, Field(ge=2, le=12)], Annotated[int, Field(ge=2, le=12)]], AfterValidator(_ordered_counts)
    ] = Field((2, 4), description="People in a group; uniform.")
    split: Number = Field(0.08, ge=0, le=1, description="Chance that a group parts at each of its goals.")
    anywhere: Number = Field(0.2, ge=0, le=1, description="Share of goals that are no exhibit: people stop anywhere.")
    doors: list[Door] = Field([], description="None: the gaps in the walls along the outline are the doors.")

    @model_validator(mode="after")
    def _consistent(self) -> WalkerParameters:
        for name, low, high in (
            ("speed", 0.2, 2.5),
            ("dwell", 0.5, 36000.0),
            ("visit", 1.0, 360000.0),
            ("away", 0.0, 360000.0),
        ):
            found = getattr(self, name)
            if found[0] < low or found[1] > high:
                raise ValueError(f"{name}: must lie within [{low:g}, {high:g}], found [{found[0]:g}, {found[1]:g}]")
        if self.pool < self.present[1]:
            raise ValueError(f"pool: {self.pool} people cannot make {self.present[1]} present")
        if self.present[1] < 1:
            raise ValueError("present: at least one person must be allowed in")
        if self.carriers > self.present[1]:
            raise ValueError(f"carriers: {self.carriers} cannot be inside where at most {self.present[1]} people are")
        ids = [door.id for door in self.doors]
        for door in self.doors:
            if ids.count(door.id) > 1:
                raise ValueError(f"doors: two are called {door.id!r}")
            if door.leads_to is not None and (door.leads_to not in ids or door.leads_to == door.id):
                raise ValueError(f"doors: {door.id}: leads_to: {door.leads_to!r} is no other door; there are: {ids}")
        return self
