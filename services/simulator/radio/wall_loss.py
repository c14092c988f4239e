"""How much do walls and obstacles between a phone and an access point swallow?

Each wall that the straight line crosses on the plan costs so many dB (the multi-wall model of COST 231, 1999). A wall
is counted once per crossed segment, so that a room drawn as one closed line costs two walls to look through.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from services.simulator.radio.shadowing import Lattice
from shared.site import FloorPlan

__all__ = ["Barriers", "LinkLoss", "crossings"]

Array = NDArray[np.float64]

_AT_ONCE = 4_000_000  # links times segments that are compared in one go


class Barriers:
    """Segments that swallow power.

    Attributes:
        segments: (s, 2, 2), ends in metres on the plan.
        loss: (s,), dB for a line that crosses the segment.
    """

    def __init__(self, lines: Iterable[tuple[Sequence[Sequence[float]] | Array, float]] = ()) -> None:
        pieces, losses = [np.empty((0, 2, 2))], [np.empty(0)]
        for line, loss in lines:
            corners = np.asarray(line, float)[:, :2]
            pieces.append(np.stack([corners[:-1], corners[1:]], axis=1))
            losses.append(np.full(len(corners) - 1, loss))
        self.segments: Array = np.concatenate(pieces)
        self.loss: Array = np.concatenate(losses)

    @classmethod
    def of(cls, plan: FloorPlan, wall_loss: float, obstacle_loss: float) -> Barriers:
        """Return a floor's walls, and its obstacles as rings that cost half on the way in and half on the way out."""
        walls = [(shapely.get_coordinates(wall), wall_loss) for wall in plan.walls.geoms]
        rings = [
            (shapely.get_coordinates(ring), obstacle_loss / 2.0)
            for polygon in plan.obstacles.geoms
            for ring in (polygon.exterior, *polygon.interiors)
        ]
        return cls((line, loss) for line, loss in [*walls, *rings] if loss > 0.0)

    def between(self, points: Array, source: Array) -> Array:
        """Return what is lost on the lines from plan points (n, 2) to ``source`` (2,), dB, (n,)."""
        if not len(self.segments):
            return np.zeros(len(points))
        lost = np.empty(len(points))
        step = max(1, _AT_ONCE // len(self.segments))
        for start in range(0, len(points), step):
            part = slice(start, start + step)
            lost[part] = crossings(points[part], source, self.segments) @ self.loss
        return lost


def crossings(points: Array, source: Array, segments: Array) -> NDArray[np.bool_]:
    """Whether the lines from points (n, 2) to ``source`` (2,) cross segments (s, 2, 2): (n, s).

    A line through the common end of two segments that go on crosses exactly one of them.
    """
    start, end = segments[:, 0], segments[:, 1]
    ray = source - points
    # On which side of the line are the segment's ends; which side of the segment are the line's ends?
    sides = [
        ray[:, :1] * (corner[:, 1] - points[:, 1:]) - ray[:, 1:] * (corner[:, 0] - points[:, :1]) > 0.0
        for corner in (start, end)
    ]
    along = end - start
    of_source = along[:, 0] * (source[1] - start[:, 1]) - along[:, 1] * (source[0] - start[:, 0]) > 0.0
    of_point = along[:, 0] * (points[:, 1:] - start[:, 1]) - along[:, 1] * (points[:, :1] - start[:, 0]) > 0.0
    crossed: NDArray[np.bool_] = (sides[0] != sides[1]) & (of_point != of_source)
    return crossed


class LinkLoss:
    """What barriers take from access points over a whole floor, cell by cell as people come there.

    The loss is that of the cell's middle: shadows of walls have edges as fine as a cell.

    Args:
        barriers: of the floor.
        sources: where the access points are, (c, 2), metres on the plan.
        lattice: of the floor.
    """

    def __init__(self, barriers: Barriers, sources: Array, lattice: Lattice) -> None:
        self._barriers = barriers
        self._sources = sources
        self._lattice = lattice
        empty = not len(barriers.segments) or not len(sources)
        cells = 0 if empty else len(lattice.x) * len(lattice.y)
        self._row = np.full(cells, -1, np.int64)  # where a cell stands in the table, once somebody came there
        self._table = np.empty((0, len(sources)))

    def at(self, points: Array) -> Array:
        """Return the losses in dB, (n, c), at plan points (n, 2)."""
        if not len(self._row):
            return np.zeros((len(points), len(self._sources)))
        cell, _ = self._lattice.cells(points)
        number = cell[:, 0] * len(self._lattice.y) + cell[:, 1]
        fresh = np.unique(number[self._row[number] < 0])
        if len(fresh):
            i, j = np.divmod(fresh, len(self._lattice.y))
            middles = np.column_stack([self._lattice.x[i], self._lattice.y[j]]) + 0.5 * self._lattice.spacing
            lost = np.column_stack([self._barriers.between(middles, source) for source in self._sources])
            self._row[fresh] = len(self._table) + np.arange(len(fresh))
            self._table = np.concatenate([self._table, lost])
        lost_here: Array = self._table[self._row[number]]
        return lost_here
