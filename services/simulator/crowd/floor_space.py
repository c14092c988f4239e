"""Where can people walk and stand on one floor? Room for bodies, ways round obstacles, viewing places, doors.

Distances that plans keep from obstacles are larger than those bodies keep: people pass an exhibit at half a metre, and
are pushed nearer by others only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import jupedsim
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import KDTree

from services.simulator.crowd.walker_parameters import Door, WalkerParameters
from shared.site import FloorPlan

__all__ = ["BODY", "DoorPlace", "FloorSpace", "spaces_of"]

Array = NDArray[np.float64]

BODY = 0.12
"""Metres from obstacles and walls where the avoidance model's own walls stand; it keeps middles another 0.1 m away."""
_CLEARANCES = (0.5, 0.42, 0.34)  # metres plans keep, the widest with which the floor stays in one piece
_PORCH = 3.5  # metres outside a door that belong to the walk in and out
_AT_EDGE = 0.6  # metres: a door nearer to the outline leads outside
_ALLOWED = f"allowed: within {_AT_EDGE:g} m of the outline, or on the floor with leads_to; never in an obstacle"
_NARROWEST = 0.8  # metres of a gap in the walls that people go through
_WIDEST = 4.0  # metres of a long gap that are used
_VIEW = 0.85  # metres from an exhibit to who looks at it
_SPACING = 0.75  # metres between viewing places


@dataclass(frozen=True, slots=True)
class DoorPlace:
    """A door on the plan.

    Attributes:
        door: as declared.
        middle: (2,), metres.
        inward: unit vector into the floor; zero for a door inside the outline.
    """

    door: Door
    middle: Array
    inward: Array

    @property
    def outside(self) -> bool:
        """Whether it leads out of the outline."""
        return bool(self.inward.any())

    def spot(self, rng: np.random.Generator, depth: float) -> Array:
        """Return a place (2,) ``depth`` metres before the door, seen from inside; round the door, if it is inside."""
        half = max(0.0, 0.5 * self.door.width - 0.35)
        if not self.outside:
            place: Array = self.middle + rng.uniform(-half, half, 2)
            return place
        along = np.array([-self.inward[1], self.inward[0]])
        before: Array = self.middle - depth * self.inward + rng.uniform(-half, half) * along
        return before


class FloorSpace:
    """One floor for its walkers.

    Args:
        name: id of the floor, for messages.
        plan: its geometry.
        doors: those declared on it.
        find_doors: whether gaps in the walls are doors too.

    Raises:
        ValueError: nobody could walk here, or nobody could come in.
    """

    def __init__(self, name: str, plan: FloorPlan, doors: Sequence[Door], find_doors: bool) -> None:
        self.plan = plan
        found = _gaps(name, plan) if find_doors else [_placed(name, plan, door) for door in doors]
        porches = [_porch(door) for door in found if door.outside]
        openings = [
            shapely.Point(door.middle).buffer(0.5 * door.door.width, cap_style="square")
            for door in found
            if not find_doors
        ]
        walls = shapely.difference(plan.walls, shapely.union_all(openings))
        space = shapely.union_all([plan.outline, *porches])
        self.room = _shrunk(plan, walls, space, BODY)
        if self.room.is_empty:
            raise ValueError(f"floor {name}: there is no room to walk between walls and obstacles")
        self.clear, self._routing = self._planning(name, plan, walls, space)
        inside = shapely.intersection(self.clear, plan.outline)
        if inside.is_empty:
            raise ValueError(f"floor {name}: there is no room to walk between walls and obstacles")
        self.inside = cast(shapely.Polygon | shapely.MultiPolygon, inside)
        self.bodies = _shrunk(plan, walls, space, 0.0 if plan.obstacles.is_empty and walls.is_empty else 0.15)
        for shape in (self.room, self.clear, self.inside, self.bodies):
            shapely.prepare(shape)
        self.doors = [door for door in found if self._reached(door)]
        lost = [door.door.id for door in found if not self._reached(door)]
        if lost and not find_doors:
            raise ValueError(
                f"floor {name}: door {lost[0]} at {self._at(found, lost[0])} opens into a wall or obstacle"
            )
        if not self.doors and find_doors:
            raise ValueError(f"floor {name}: no gap in the walls leads to where people can walk; declare doors")
        self.viewing, self.look_at, self.exhibit = self._viewing_places()
        self._viewing_tree = KDTree(self.viewing) if len(self.viewing) else None
        self.exhibits = int(self.exhibit.max()) + 1 if len(self.exhibit) else 0

    def path(self, start: Array, goal: Array) -> list[Array]:
        """Return the corners (2,) of a shortest way from ``start`` to ``goal``, the goal last."""
        start, goal = self.nearest_clear(start), self.nearest_clear(goal)
        try:
            corners = self._routing.compute_waypoints(
                (float(start[0]), float(start[1])), (float(goal[0]), float(goal[1]))
            )
        except RuntimeError:  # a hair outside of the mesh: the avoidance model finds the way by itself
            return [goal]
        return [np.array(corner) for corner in corners[1:-1]] + [goal]

    def nearest_clear(self, place: Array) -> Array:
        """Return the place (2,) itself, or the nearest one that plans may lead to."""
        return _pulled_into(self.clear, place)

    def nearest_body(self, place: Array) -> Array:
        """Return the place (2,) itself, or the nearest one where a body fits."""
        return _pulled_into(self.bodies, place)

    def is_clear(self, place: Array) -> bool:
        """Whether plans may lead to (2,)."""
        return bool(shapely.contains_xy(self.clear, place[0], place[1]))

    def random_place(self, rng: np.random.Generator) -> Array:
        """Return a place (2,) anywhere inside the outline."""
        left, bottom, right, top = self.inside.bounds
        for _ in range(200):
            place: Array = rng.uniform([left, bottom], [right, top])
            if shapely.contains_xy(self.inside, place[0], place[1]):
                return place
        return np.array(self.inside.representative_point().coords[0])

    def viewing_near(self, places: Array, distance: float) -> NDArray[np.bool_]:
        """Whether each viewing place is less than ``distance`` from any of (m, 2) ``places``, (v,)."""
        near = np.zeros(len(self.viewing), bool)
        if self._viewing_tree is not None and len(places):
            for found in self._viewing_tree.query_ball_point(places, distance):
                near[found] = True
        return near

    def _planning(
        self, name: str, plan: FloorPlan, walls: shapely.Geometry, space: shapely.Geometry
    ) -> tuple[shapely.Polygon, jupedsim.RoutingEngine]:
        best = shapely.Polygon()
        for clearance in _CLEARANCES:
            clear = _shrunk(plan, walls, space, clearance)
            # What a wide berth loses to narrow doors is more than the strip along the walls.
            strip = (clearance - BODY) * 1.3 * self.room.length
            if clear.area > max(best.area * 1.2, 0.0):
                best = clear
            if clear.area >= self.room.area - strip:
                break
        # A hair larger, so that ways may run along its edge.
        grown = _largest(shapely.intersection(shapely.buffer(best, 0.02, join_style="mitre"), self.room))
        if grown.is_empty or not shapely.intersects(grown, plan.outline):
            raise ValueError(f"floor {name}: there is no room to walk between walls and obstacles")
        return best, jupedsim.RoutingEngine(grown)

    def _reached(self, door: DoorPlace) -> bool:
        return self.clear.distance(shapely.Point(door.middle)) < max(0.7, 0.5 * door.door.width)

    def _at(self, found: Sequence[DoorPlace], wanted: str) -> tuple[float, float]:
        return next(place.door.position for place in found if place.door.id == wanted)

    def _viewing_places(self) -> tuple[Array, Array, NDArray[np.int64]]:
        """Return places round the obstacles (v, 2), what each looks at (v, 2) and whose it is (v,)."""
        places: list[Array] = []
        looks: list[Array] = []
        owners: list[int] = []
        owner = 0
        for obstacle in self.plan.obstacles.geoms:
            ring = obstacle.buffer(_VIEW).exterior
            before = len(places)
            for along in np.arange(0.0, ring.length - 0.5 * _SPACING, _SPACING):
                point = ring.interpolate(along)
                if shapely.contains(self.inside, point):
                    near = np.array(shapely.shortest_line(obstacle, point).coords[0])
                    # Between the nearest point of the exhibit and its middle: nobody stares at an edge.
                    places.append(np.array(point.coords[0]))
                    looks.append(0.6 * near + 0.4 * np.array(obstacle.centroid.coords[0]))
                    owners.append(owner)
            owner += len(places) > before
        shape = (len(places), 2)
        return np.array(places).reshape(shape), np.array(looks).reshape(shape), np.array(owners, np.int64)


def spaces_of(plans: Mapping[str, FloorPlan], parameters: WalkerParameters) -> dict[str, FloorSpace]:
    """Return the floors of a site for walkers, by id.

    Raises:
        ValueError: there is none, nobody could walk or come in on one, or a door is where none can be.
    """
    if not plans:
        raise ValueError("a crowd needs at least one floor")
    for door in parameters.doors:
        if door.floor not in plans:
            raise ValueError(f"doors: {door.id}: there is no floor {door.floor!r}; the site has: {', '.join(plans)}")
    return {
        name: FloorSpace(name, plan, [door for door in parameters.doors if door.floor == name], not parameters.doors)
        for name, plan in plans.items()
    }


def _shrunk(plan: FloorPlan, walls: shapely.Geometry, space: shapely.Geometry, margin: float) -> shapely.Polygon:
    room: shapely.Geometry = shapely.buffer(space, -margin, join_style="mitre")
    for taken in (plan.obstacles, walls):
        room = shapely.difference(room, shapely.buffer(taken, max(margin, 1e-3), join_style="mitre", mitre_limit=2.0))
    return _largest(shapely.simplify(room, 0.01))


def _largest(shape: shapely.Geometry) -> shapely.Polygon:
    """Return the largest piece: what cannot be reached from it is no place to send people to."""
    parts = [part for part in shapely.get_parts(shape) if isinstance(part, shapely.Polygon)]
    return max(parts, key=lambda part: part.area, default=shapely.Polygon())


def _pulled_into(shape: shapely.Geometry, place: Array) -> Array:
    if shapely.intersects_xy(shape, place[0], place[1]):
        return np.asarray(place, float)
    nearest = shapely.shortest_line(shape, shapely.Point(place))
    return np.asarray(nearest.coords[0], float)


def _inward(plan: FloorPlan, middle: Array, along: Array) -> Array:
    inward = np.array([-along[1], along[0]])
    return inward if shapely.intersects_xy(plan.outline, *(middle + 0.05 * inward)) else -inward


def _placed(name: str, plan: FloorPlan, door: Door) -> DoorPlace:
    point = shapely.Point(door.position)
    edge = plan.outline.exterior
    away = edge.distance(point)
    where = f"doors: {door.id}: position {list(door.position)}"
    if shapely.contains(plan.obstacles, point):
        raise ValueError(f"{where} lies in an obstacle of floor {name}; {_ALLOWED}")
    if away > _AT_EDGE:
        if not shapely.covers(plan.outline, point):
            raise ValueError(f"{where} is {away:.1f} m outside the outline of floor {name}; {_ALLOWED}")
        if door.leads_to is None:
            raise ValueError(f"{where} is {away:.1f} m inside the outline of floor {name}; {_ALLOWED}")
        return DoorPlace(door, np.array(door.position), np.zeros(2))
    if door.leads_to is not None:
        return DoorPlace(door, np.array(door.position), np.zeros(2))
    for start, end in zip(edge.coords[:-1], edge.coords[1:], strict=True):
        if shapely.LineString([start, end]).distance(point) <= away + 1e-9:
            first, last = np.array(start), np.array(end)
            along = (last - first) / math.dist(first, last)
            middle = first + along * float((np.array(door.position) - first) @ along)
            return DoorPlace(door, middle, _inward(plan, middle, along))
    raise AssertionError("some edge is the nearest")  # pragma: no cover


def _gaps(name: str, plan: FloorPlan) -> list[DoorPlace]:
    """Find the straight stretches of the outline without a wall; each is a door, its middle the door's."""
    edge = plan.outline.exterior
    found: list[DoorPlace] = []
    for start, end in zip(edge.coords[:-1], edge.coords[1:], strict=True):
        stretch: shapely.Geometry = shapely.LineString([start, end])
        if not plan.walls.is_empty:
            stretch = shapely.difference(stretch, plan.walls.buffer(0.05))
        for part in shapely.get_parts(stretch):
            if part.length < _NARROWEST:
                continue
            first, last = np.array(part.coords[0]), np.array(part.coords[-1])
            middle = 0.5 * (first + last)
            door = Door(
                id=f"{name}-door-{len(found) + 1}",
                floor=name,
                position=(float(middle[0]), float(middle[1])),
                width=min(part.length, _WIDEST),
            )
            found.append(DoorPlace(door, middle, _inward(plan, middle, (last - first) / part.length)))
    if not found:
        raise ValueError(f"floor {name}: the outline is walled all round: leave a gap in the walls or declare doors")
    return found


def _porch(door: DoorPlace) -> shapely.Polygon:
    along = np.array([-door.inward[1], door.inward[0]])
    half = 0.5 * max(door.door.width, 1.4)
    corners = [(-half, 0.7), (half, 0.7), (half, -_PORCH), (-half, -_PORCH)]
    return shapely.Polygon([door.middle + side * along + depth * door.inward for side, depth in corners])
