"""Does it lie where a client asks for? One answer for reads and streams."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.api.problems import unknown
from services.api.request_body import invalid
from services.api.zones_drawn import ZonesDrawn

__all__ = ["NEAR", "Place", "circle"]

NEAR = "x,y,radius: three finite numbers in metres, such as 9.5,3,2; the radius above 0"


@dataclass(frozen=True, slots=True)
class Place:
    """Where a client wants to be told of; None: anywhere. ``near``: x, y and radius in metres."""

    zone: str | None = None
    near: tuple[float, float, float] | None = None
    floor: str | None = None

    @property
    def anywhere(self) -> bool:
        """Whether nothing is asked for."""
        return self.zone is None and self.near is None and self.floor is None

    def check(self, zones: ZonesDrawn, floors: Sequence[str]) -> None:
        """Refuse what the site does not have.

        Raises:
            ProblemError: there is no such zone or floor, or ``near`` leaves open on which of several floors.
        """
        if self.zone is not None and self.zone not in zones.ids:
            raise unknown("zone", self.zone)
        if self.floor is not None and self.floor not in floors:
            raise unknown("floor", self.floor, list(floors))
        if self.near is not None and self.floor is None and len(floors) > 1:
            raise invalid("floor", "nothing", f"the floor that near is meant on: {', '.join(floors)}")

    def holds(
        self, zones: ZonesDrawn, floor: NDArray[np.object_], x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """Return, (n,), which of n points (floors; metres) lie there; of a zone that is no more, none."""
        held = np.ones(len(x), dtype=bool)
        if self.floor is not None:
            held &= floor == self.floor
        if self.near is not None:
            held &= np.hypot(x - self.near[0], y - self.near[1]) <= self.near[2]
        if self.zone is not None:
            person, zone = zones.within(floor, x, y)
            inside = np.zeros(len(x), dtype=bool)
            inside[person[zone == zones.ids.get(self.zone, -1)]] = True
            held &= inside
        return held


def circle(text: str) -> tuple[float, float, float]:
    """Return x, y and radius as ``near`` of a query says them.

    Raises:
        ProblemError: it does not.
    """
    try:
        x, y, radius = (float(part) for part in text.split(","))
    except ValueError:
        raise invalid("near", text, NEAR) from None
    if not all(map(math.isfinite, (x, y, radius))) or radius <= 0.0:
        raise invalid("near", text, NEAR)
    return x, y, radius
