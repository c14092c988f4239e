"""Where is everybody, and how do they move? What walkers and trajectory tables answer alike.

Times here are the world's own: seconds since the walkers set off, or the time column of a table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["Motion", "People", "Snapshot"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Everybody who is on the floor at one time.

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


@dataclass(frozen=True, slots=True)
class Motion:
    """How one person moved over a stretch of time.

    Attributes:
        position: (n, 2), metres; NaN while nothing is known of the person.
        heading: where the body faces, (n,), radians, unwrapped.
        speed: (n,), m/s.
        present: whether the person was on the floor, (n,).
    """

    position: Array
    heading: Array
    speed: Array
    present: NDArray[np.bool_]

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether the person was on the floor or near it, (n,): where a phone would be heard."""
        known: NDArray[np.bool_] = np.isfinite(self.position[:, 0])
        return known


class People(Protocol):
    """A crowd whose whereabouts can be asked for at any time that has been reached."""

    @property
    def persons(self) -> Sequence[str]:
        """Everybody who ever appears."""
        ...

    def snapshot(self, t: float) -> Snapshot:
        """Return everybody on the floor at time ``t``."""
        ...

    def motion(self, person: str, times: Array) -> Motion:
        """Return how ``person`` moved at increasing ``times`` (n,). KeyError: nobody of that name."""
        ...

    def instants(self, after: float, until: float) -> Array:
        """Return the times in (after, until] at which the truth is told."""
        ...
