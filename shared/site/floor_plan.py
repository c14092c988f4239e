"""What is where on one floor: outline, walls and obstacles as shapely geometry, and the questions asked of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

__all__ = ["FloorPlan"]

Ring = Sequence[tuple[float, float]]


@dataclass(frozen=True)
class FloorPlan:
    """One floor's geometry, metres.

    Attributes:
        outline: where people can be.
        walls: lines nobody walks through.
        obstacles: polygons nobody stands in.
    """

    outline: shapely.Polygon
    walls: shapely.MultiLineString
    obstacles: shapely.MultiPolygon

    @classmethod
    def build(cls, outline: Ring, walls: Sequence[Ring] = (), obstacles: Sequence[Ring] = ()) -> FloorPlan:
        """Return the plan drawn by these rings and polylines of (x, y) metres."""
        plan = cls(
            outline=shapely.Polygon(outline),
            walls=shapely.MultiLineString([list(wall) for wall in walls]),
            obstacles=_united([shapely.Polygon(ring) for ring in obstacles]),
        )
        for shape in (plan.outline, plan.walls, plan.obstacles):
            shapely.prepare(shape)
        return plan

    def contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether each of (n, 2) points lies on the floor, its edge included."""
        inside: NDArray[np.bool_] = shapely.intersects_xy(self.outline, points[:, 0], points[:, 1])
        return inside

    def walkable(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether a person can stand at each of (n, 2) points: on the floor and in no obstacle."""
        blocked = shapely.contains_xy(self.obstacles, points[:, 0], points[:, 1])
        return self.contains(points) & ~blocked

    def walls_crossed(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> NDArray[np.int64]:
        """How many walls stand between (n, 2) ``start`` and (n, 2) ``end``; none where the two are one place."""
        if self.walls.is_empty:
            return np.zeros(len(start), dtype=np.int64)
        lines = np.asarray(shapely.linestrings(np.stack([start, end], axis=1)), dtype=object).reshape(-1)
        walls = np.asarray(self.walls.geoms, dtype=object)
        crossed: NDArray[np.int64] = shapely.intersects(lines[:, None], walls[None, :]).sum(axis=1)
        return crossed


def _united(polygons: Sequence[shapely.Polygon]) -> shapely.MultiPolygon:
    """Return the polygons as one valid shape: where drawn obstacles overlap, both block."""
    union = shapely.union_all(polygons)
    parts = [part for part in shapely.get_parts(union) if isinstance(part, shapely.Polygon)]
    return shapely.MultiPolygon(parts)
