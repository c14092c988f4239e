"""How did everybody move in the last minute and a half? A ring of regular steps, asked at any times in between.

In between, a cubic through the neighbouring steps (Catmull and Rom's), so that velocities are continuous and
differentiating twice gives accelerations a body could have; where a person appeared, left or changed floors it does not
reach over the gap.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.simulator.people import Movement

__all__ = ["REMEMBERED", "WalkHistory"]

Array = NDArray[np.float64]

REMEMBERED = 900
"""Steps that can be asked for."""


class WalkHistory:
    """The ring.

    Args:
        count: people.
        step: seconds between two rows; row k is at k · step.
    """

    def __init__(self, count: int, step: float) -> None:
        self._step = step
        self._last = -1
        # x, y, heading, speed, walked
        self._rows = np.full((REMEMBERED + 3, count, 5), np.nan)
        self._floor = np.full((REMEMBERED + 3, count), -1, np.int16)
        self._present = np.zeros((REMEMBERED + 3, count), bool)

    def needed(self, t: float) -> int:
        """Return the last row that an answer for time ``t`` rests on."""
        return max(0, int(np.floor(t / self._step + 1e-9))) + 2

    def record(self, rows: Array, floor: NDArray[np.int16], present: NDArray[np.bool_]) -> None:
        """Append the next row: (p, 5) of x, y, heading, speed, walked; (p,) floor, -1 for unknown; (p,) present."""
        self._last += 1
        place = self._last % len(self._rows)
        self._rows[place] = np.where((floor >= 0)[:, None], rows, np.nan)
        self._floor[place], self._present[place] = floor, present

    def movement(self, times: Array, persons: NDArray[np.int64] | None) -> Movement:
        """Return the movement at (n,) times, all rows that are ``needed`` recorded; times before 0 count as 0."""
        place = np.maximum(np.asarray(times, float) / self._step, 0.0)
        before = np.floor(place + 1e-9).astype(int)
        share = np.clip(place - before, 0.0, 1.0)
        size = len(self._rows)
        columns = np.arange(self._rows.shape[1]) if persons is None else persons
        corner = (np.maximum(before[:, None] + np.arange(-1, 3), 0) % size)[..., None]
        rows, floors = self._rows[corner, columns], self._floor[corner, columns]
        presence = self._present[corner, columns]
        nearest = np.where(share < 0.5, 1, 2)
        every = np.arange(len(place))
        floor, present = floors[every, nearest].copy(), presence[every, nearest].copy()
        values = self._between(rows, floors, share, nearest)
        gone = before <= self._last - REMEMBERED
        values[gone], floor[gone], present[gone] = np.nan, -1, False
        return Movement(
            position=values[..., :2],
            heading=values[..., 2],
            speed=np.maximum(values[..., 3], 0.0),
            walked=values[..., 4],
            floor=floor,
            present=present,
        )

    @staticmethod
    def _between(rows: Array, floors: NDArray[np.int16], share: Array, nearest: NDArray[np.int64]) -> Array:
        """Interpolate (n, 4, p, 5) between the second and the third row."""
        first, second = rows[:, 1], rows[:, 2]
        joined = (floors[:, 1] == floors[:, 2])[..., None]
        # Beyond a gap the walk is continued straight.
        start = np.where((floors[:, 0] == floors[:, 1])[..., None], rows[:, 0], 2.0 * first - second)
        end = np.where((floors[:, 3] == floors[:, 2])[..., None], rows[:, 3], 2.0 * second - first)
        u = share[:, None, None]
        slope, last_slope = 0.5 * (second - start), 0.5 * (end - first)
        cubic = (
            (1.0 + u**2 * (2.0 * u - 3.0)) * first
            + u * (1.0 - u) ** 2 * slope
            + u**2 * (3.0 - 2.0 * u) * second
            + u**2 * (u - 1.0) * last_slope
        )
        # A distance walked never shrinks.
        cubic[..., 4] = first[..., 4] + share[:, None] * (second[..., 4] - first[..., 4])
        alone = np.take_along_axis(rows, nearest[:, None, None, None], axis=1)[:, 0]
        chosen: Array = np.where(joined, cubic, alone)
        return chosen
