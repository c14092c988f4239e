"""Which way round the exhibits? Where people can walk, where they come in, and shortest paths between two places."""

from __future__ import annotations

import heapq
import itertools
import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from shared.site import FloorPlan

__all__ = ["Entrance", "Routes"]

Array = NDArray[np.float64]

CLEARANCE = 0.45
"""Metres that planned paths keep from walls and exhibits."""
BODY = 0.25
"""Metres from walls and exhibits that nobody's middle ever comes nearer to."""
_PORCH = 4.0  # how far outside the entrance people wait, metres
_WIDEST_ENTRANCE = 4.0


@dataclass(frozen=True, slots=True)
class Entrance:
    """Where people come in: the middle of the gap, its width, and the unit vector into the floor."""

    middle: Array
    width: float
    inward: Array

    def outside(self, sideways: float, distance: float) -> Array:
        """Return the place (2,) before the entrance, ``sideways`` metres off its axis."""
        along = np.array([-self.inward[1], self.inward[0]])
        place: Array = self.middle - distance * self.inward + sideways * along
        return place


class Routes:
    """Shortest paths by a visibility graph on the plan, obstacles grown by the clearance.

    Raises:
        ValueError: the outline is walled all round, or there is no room to walk.
    """

    def __init__(self, plan: FloorPlan) -> None:
        self.plan = plan
        self.entrance = _entrance(plan)
        half = 0.5 * self.entrance.width
        corners = [(-half, -0.5), (half, -0.5), (half, _PORCH), (-half, _PORCH)]
        self.porch = shapely.Polygon([self.entrance.outside(side, out) for side, out in corners])
        space = plan.outline.union(self.porch)
        self.room = _shrunk(plan, space, BODY)
        self._free = _shrunk(plan, space, CLEARANCE)
        if self._free.is_empty:
            raise ValueError("there is no room to walk between walls and obstacles")
        shapely.prepare(self._free)
        shapely.prepare(self.room)
        # Grown a hair, so that paths may run along its edge and through its corners.
        self._clear = shapely.buffer(self._free, 1e-6)
        shapely.prepare(self._clear)
        self._nodes = _corners(shapely.simplify(self._free, 0.0))
        self._visible = self._visibility(self._nodes, self._nodes)

    def clear(self, start: Array, end: Array) -> bool:
        """Whether one can walk straight from (2,) to (2,)."""
        return bool(shapely.covers(self._clear, shapely.LineString([start, end])))

    def path(self, start: Array, goal: Array) -> list[Array]:
        """Return the corners to walk by, the goal last; places too near an obstacle are first moved off it."""
        start, goal = self.nearest_free(start), self.nearest_free(goal)
        if self.clear(start, goal):
            return [goal]
        ends = np.stack([start, goal])
        to_nodes = self._visibility(ends, self._nodes)
        count = len(self._nodes)
        points = np.vstack([self._nodes, ends])
        best = np.full(count + 2, np.inf)
        best[count] = 0.0
        before = np.full(count + 2, -1)
        queue = [(0.0, count)]
        while queue:
            cost, here = heapq.heappop(queue)
            if here == count + 1:
                break
            if cost > best[here]:
                continue
            sees = to_nodes[0] if here == count else self._visible[here]
            reach: list[int] = np.flatnonzero(sees).tolist()
            if here < count and to_nodes[1, here]:
                reach.append(count + 1)
            for there in reach:
                total = cost + math.dist(points[here], points[there])
                if total < best[there]:
                    best[there], before[there] = total, here
                    heapq.heappush(queue, (total, there))
        if before[count + 1] < 0:
            return [goal]
        corners, here = [], count + 1
        while here != count:
            corners.append(points[here])
            here = int(before[here])
        return corners[::-1]

    def nearest_free(self, place: Array) -> Array:
        """Return the place itself, or the nearest one with clearance all round."""
        return _pulled_into(self._free, place)

    def nearest_room(self, place: Array) -> Array:
        """Return the place itself, or the nearest one where a body fits."""
        return _pulled_into(self.room, place)

    def _visibility(self, starts: Array, ends: Array) -> NDArray[np.bool_]:
        pairs = np.stack(np.broadcast_arrays(starts[:, None], ends[None]), axis=2)
        lines = shapely.linestrings(pairs.reshape(-1, 2, 2))
        seen: NDArray[np.bool_] = shapely.covers(self._clear, lines).reshape(len(starts), len(ends))
        return seen


def _shrunk(plan: FloorPlan, space: shapely.Geometry, margin: float) -> shapely.Polygon:
    room: shapely.Geometry = shapely.buffer(space, -margin)
    for taken in (plan.obstacles, plan.walls):
        room = shapely.difference(room, shapely.buffer(taken, margin, quad_segs=2))
    parts = [part for part in shapely.get_parts(room) if isinstance(part, shapely.Polygon)]
    # What cannot be reached from the largest part is no place to send people to.
    return max(parts, key=lambda part: part.area, default=shapely.Polygon())


def _corners(shape: shapely.Polygon) -> Array:
    rings = [shape.exterior, *shape.interiors]
    return np.vstack([np.asarray(ring.coords)[:-1] for ring in rings])


def _pulled_into(shape: shapely.Geometry, place: Array) -> Array:
    point = shapely.Point(place)
    if shapely.covers(shape, point):
        return np.asarray(place, float)
    nearest = shapely.shortest_line(shape, point)
    return np.asarray(nearest.coords[0], float)


def _entrance(plan: FloorPlan) -> Entrance:
    """Find the widest straight stretch of the outline without a wall."""
    edge = plan.outline.exterior
    open_edge = edge if plan.walls.is_empty else edge.difference(plan.walls.buffer(0.05))
    stretches: list[tuple[Array, Array]] = []
    for part in shapely.get_parts(open_edge):
        points = np.asarray(part.coords)
        stretches += itertools.pairwise(points)
    if not stretches:
        raise ValueError("the outline is walled all round: leave a gap in the walls for an entrance")
    start, end = max(stretches, key=lambda pair: math.dist(*pair))
    width = math.dist(start, end)
    if width < 2.0 * CLEARANCE + 0.2:
        raise ValueError(f"the widest gap in the walls is {width:.1f} m: an entrance needs {2 * CLEARANCE + 0.2:.1f} m")
    middle = 0.5 * (start + end)
    across = (end - start) / width
    inward = np.array([-across[1], across[0]])
    if not shapely.covers(plan.outline, shapely.Point(middle + 0.05 * inward)):
        inward = -inward
    return Entrance(middle, min(width, _WIDEST_ENTRANCE), inward)
