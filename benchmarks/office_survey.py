"""What would the office study's surveyor have heard? Scans at reference points along corridors, on another day.

After [self-calibrating-rss-thesis §4.1, §8.1]: points some 1.5 m apart; in corridors half of the scans facing each way
along, in the open space a fourth facing each of four ways; one phone. Each way is a round of its own through the whole
building, as one who carries the phone would do it, so that scans of one point and way follow one another and share
what fades slowly, and those of another way do not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines.survey import Survey
from services.simulator.radio.radio_world import PhoneRadio, RadioWorld
from shared.site import Site

__all__ = ["CORRIDORS", "SPACING", "ReferencePoints", "Surveyor", "reference_points"]

Array = NDArray[np.float64]

SPACING = 1.5
"""Metres between reference points."""
SCAN_EVERY = 1.5
"""Seconds."""
BETWEEN_ROUNDS = 1200.0
"""Seconds from one round's end to the next one's beginning."""
ANOTHER_DAY = 100_000.0
"""World seconds of the first scan: what drifts has long forgotten how it was while the testers walked."""

CORRIDORS: Sequence[tuple[tuple[float, float], tuple[float, float]]] = (
    ((1.0, 2.75), (1.0, 8.75)),
    ((2.25, 9.0), (8.25, 9.0)),
    ((15.75, 9.0), (21.75, 9.0)),
    ((23.0, 9.0), (23.0, 15.0)),
    ((22.5, 17.0), (13.5, 17.0)),
    ((12.0, 17.0), (12.0, 12.5)),
)
"""Middle lines of the office's straight pieces of corridor, metres, each a whole number of spacings long."""
OPEN_SPACE = ((10.0, 12.0, 14.0), (7.0, 9.0, 11.0))
"""Columns and rows of the points in the open space, metres."""


@dataclass(frozen=True, slots=True)
class ReferencePoints:
    """Where a surveyor stands.

    Attributes:
        position: (s, 2) metres.
        facing: of each point the ways to face, radians counter-clockwise from +x.
    """

    position: Array
    facing: Sequence[Sequence[float]]


def reference_points() -> ReferencePoints:
    """Return the office's points: corridors first, then the open space."""
    position: list[tuple[float, float]] = []
    facing: list[tuple[float, ...]] = []
    for (x, y), (to_x, to_y) in CORRIDORS:
        count = round(math.hypot(to_x - x, to_y - y) / SPACING) + 1
        along = math.atan2(to_y - y, to_x - x)
        position += zip(np.linspace(x, to_x, count).tolist(), np.linspace(y, to_y, count).tolist(), strict=True)
        facing += [(along, along + math.pi)] * count
    for x in OPEN_SPACE[0]:
        for y in OPEN_SPACE[1]:
            position.append((x, y))
            facing.append((0.0, 0.5 * math.pi, math.pi, 1.5 * math.pi))
    return ReferencePoints(np.array(position), facing)


class Surveyor:
    """Somebody with one phone who goes through the office again and again. Time goes on from survey to survey.

    Args:
        radio: of the world.
        site: where; the first floor is surveyed.
        points: where to stand.
    """

    def __init__(self, radio: RadioWorld, site: Site, points: ReferencePoints) -> None:
        self._phone: PhoneRadio = radio.phone("surveyor")
        self._names = radio.access_points
        self._floor = site.floors[0].id
        self._points = points
        self._t = ANOTHER_DAY

    def survey(self, samples: int) -> Survey:
        """Return so many scans at each point, in equal parts (one more or less) facing each of its ways."""
        position = self._points.position
        readings = np.full((len(position), samples, len(self._names)), np.nan)
        for turn in range(max(len(ways) for ways in self._points.facing)):
            for place, ways in enumerate(self._points.facing):
                if turn >= len(ways):
                    continue
                share = np.arange(turn, samples, len(ways))
                t = self._t + SCAN_EVERY * np.arange(len(share))
                there = np.tile(position[place], (len(share), 1))
                readings[place, share] = self._phone.scan(t, there, self._floor, np.full(len(share), ways[turn]))
                self._t += SCAN_EVERY * (len(share) + 1)
            self._t += BETWEEN_ROUNDS
        return Survey(self._names, position, readings)
