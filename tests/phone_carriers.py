"""People who walk where a test wants them to: along a path at given speeds, everybody the same."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from services.simulator.people import Movement


class WalkingPeople:
    """People on one path.

    Args:
        legs: (seconds, m/s, direction in radians) one after the other; the last one goes on for ever.
        start: where it begins, metres.
        away: (from, until) in seconds while nothing is known of anybody.
        persons: who they are.
    """

    def __init__(
        self,
        legs: Sequence[tuple[float, float, float]],
        start: tuple[float, float] = (2.0, 2.0),
        away: tuple[float, float] = (0.0, 0.0),
        persons: Sequence[str] = ("ann",),
        floor: str = "ground",
    ) -> None:
        self.persons = list(persons)
        self.floors = [floor]
        self._away = away
        self._t = np.arange(0.0, sum(seconds for seconds, _, _ in legs) + 0.1, 0.1)
        bounds = np.cumsum([seconds for seconds, _, _ in legs])
        leg = np.minimum(np.searchsorted(bounds, self._t, side="right"), len(legs) - 1)
        self._speed = np.array([speed for _, speed, _ in legs])[leg]
        self._heading = np.array([direction for _, _, direction in legs])[leg]
        step = self._speed[:-1] * np.diff(self._t)
        self._walked = np.concatenate([[0.0], np.cumsum(step)])
        along = np.column_stack([np.cos(self._heading[:-1]), np.sin(self._heading[:-1])]) * step[:, None]
        self._position = np.array(start) + np.concatenate([np.zeros((1, 2)), np.cumsum(along, axis=0)])

    def movement(
        self, times: NDArray[np.float64], persons: Sequence[int] | NDArray[np.int64] | None = None
    ) -> Movement:
        p = len(self.persons if persons is None else persons)

        def everybody(column: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.repeat(np.interp(times, self._t, column)[:, None], p, axis=1)

        gone = ((times >= self._away[0]) & (times < self._away[1]))[:, None] | np.zeros((1, p), bool)
        columns = [everybody(column) for column in (*self._position.T, self._heading, self._speed, self._walked)]
        x, y, heading, speed, walked = (np.where(gone, np.nan, column) for column in columns)
        floor = np.where(gone, -1, 0).astype(np.int16)
        return Movement(np.stack([x, y], axis=-1), heading, speed, walked, floor, floor >= 0)

    def instants(self, after: float, until: float) -> NDArray[np.float64]:
        return self._t[(self._t > after) & (self._t <= until)]

    def walked(self, t: float) -> float:
        return float(np.interp(t, self._t, self._walked))
