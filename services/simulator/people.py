"""Where is everybody, and how do they move? What simulated crowds and trajectory tables answer alike.

Times here are the world's own: seconds since the world began, or the time column of a table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["BLOCK", "Movement", "People", "Snapshot", "snapshot"]

Array = NDArray[np.float64]

BLOCK = 5.0
"""Seconds of world that are made at once. A constant of the world: what it holds depends on it, to the bit."""


@dataclass(frozen=True, slots=True)
class Movement:
    """How p people moved at n times.

    Attributes:
        position: (n, p, 2), metres on the plan of their floor; NaN while nothing is known of the person.
        heading: where the body faces, (n, p), radians counter-clockwise from +x, continuous in time.
        speed: (n, p), m/s.
        walked: (n, p), metres walked so far; legs swing by it.
        floor: (n, p), places in ``People.floors``; -1 while nothing is known of the person.
        present: (n, p), whether the person is on the floor (inside its outline): to be seen, counted and found. Who is
            known but not present is near by, outside the door: no camera sees them, but their phone is heard.
    """

    position: Array
    heading: Array
    speed: Array
    walked: Array
    floor: NDArray[np.int16]
    present: NDArray[np.bool_]

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether the person is on the floor or near it, (n, p): where a phone would be heard."""
        known: NDArray[np.bool_] = self.floor >= 0
        return known


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Everybody who is present on one floor at one time.

    Attributes:
        person: n ids.
        index: their places in ``People.persons``, (n,).
        position: (n, 2), metres.
        heading: where they face, (n,), radians counter-clockwise from +x.
        speed: (n,), m/s.
        walked: metres walked so far, (n,); a walker's legs swing by it.
    """

    person: Sequence[str]
    index: NDArray[np.int64]
    position: Array
    heading: Array
    speed: Array
    walked: Array


class People(Protocol):
    """A crowd whose whereabouts can be asked for at any time; some remember only the last half minute."""

    @property
    def persons(self) -> Sequence[str]:
        """Everybody who ever appears."""
        ...

    @property
    def floors(self) -> Sequence[str]:
        """Ids of the floors they walk on."""
        ...

    def movement(self, times: Array, persons: Sequence[int] | NDArray[np.int64] | None = None) -> Movement:
        """Return how people moved at increasing ``times`` (n,), walking on as far as needed.

        Args:
            times: seconds; what lies longer ago than the crowd remembers is unknown (NaN, -1).
            persons: p places in ``persons``; None for everybody.
        """
        ...

    def instants(self, after: float, until: float) -> Array:
        """Return the times in (after, until] at which the truth is told."""
        ...


def snapshot(people: People, t: float, floor: str) -> Snapshot:
    """Return everybody present on ``floor`` at time ``t``. ValueError: nobody ever walks on that floor."""
    now = people.movement(np.array([t]))
    index = np.flatnonzero(now.present[0] & (now.floor[0] == people.floors.index(floor)))
    return Snapshot(
        person=[people.persons[i] for i in index.tolist()],
        index=index,
        position=now.position[0, index],
        heading=now.heading[0, index],
        speed=now.speed[0, index],
        walked=now.walked[0, index],
    )
