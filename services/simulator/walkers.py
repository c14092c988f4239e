"""Visitors of a hall: they come in, look at one exhibit after the other, keep out of each other's way, and leave.

Each walks a shortest path to a viewing place, turns and speeds up smoothly, gives way to the right, and stays a while
facing the exhibit, shifting from foot to foot; who has left comes back later. The step is fixed and all randomness
comes from one seed, so that the same seed walks the same way however often time is asked for.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely
from numpy.typing import NDArray

from services.simulator.people import Motion, Snapshot
from services.simulator.routes import Routes
from services.simulator.seeds import generator
from shared.site import FloorPlan

__all__ = ["STEP", "VisitParameters", "Walkers"]

Array = NDArray[np.float64]

STEP = 0.1
"""Seconds between two steps of the simulation; in between, positions are interpolated."""
_REMEMBERED = 300  # steps of history that can be asked for
_APART = 0.55  # metres nobody comes nearer to another than
_AWARE = 1.6  # metres from which people give way


@dataclass(frozen=True, slots=True)
class VisitParameters:
    """What visitors do. Ranges are drawn from uniformly; seconds, metres per second."""

    arrival_gap: tuple[float, float] = (1.5, 4.0)
    """Between one visitor's first arrival and the next."""
    speed: tuple[float, float] = (0.75, 1.3)
    exhibits: tuple[int, int] = (4, 8)
    """How many viewing places before leaving."""
    dwell: tuple[float, float] = (3.0, 9.0)
    away: tuple[float, float] = (8.0, 25.0)
    """Between leaving and coming back."""


@dataclass(slots=True)
class _Visitor:
    """What one visitor is about to do."""

    rng: np.random.Generator
    cruise: float
    wake: float
    """Until when the visitor stays where they are."""
    path: list[Array] = field(default_factory=list)
    look_at: Array | None = None
    places_left: int = 0
    inside: bool = False
    stuck: float = 0.0
    sway: float = 0.0


class Walkers:
    """A seeded crowd on one floor.

    Args:
        plan: the floor.
        count: how many visitors.
        seed: of everything they do.
        parameters: what they do.

    Raises:
        ValueError: nobody could walk on this plan.
    """

    def __init__(self, plan: FloorPlan, count: int, seed: int, parameters: VisitParameters | None = None) -> None:
        self.routes = Routes(plan)
        self._plan = plan
        self._parameters = parameters or VisitParameters()
        self._places = _viewing_places(plan, self.routes)
        self._persons = tuple(f"visitor-{number}" for number in range(1, count + 1))
        rngs = [generator(seed, "visitor", person) for person in self._persons]
        arrivals = np.cumsum([rng.uniform(*self._parameters.arrival_gap) for rng in rngs])
        self._visitors = [
            _Visitor(rng, rng.uniform(*self._parameters.speed), wake, sway=rng.uniform(0.0, 6.0))
            for rng, wake in zip(rngs, arrivals.tolist(), strict=True)
        ]
        width = 0.5 * self.routes.entrance.width
        places = [
            self.routes.entrance.outside(rng.uniform(-width, width), 1.2 + 0.7 * (number % 4))
            for number, rng in enumerate(rngs)
        ]
        self._position: Array = self._settled(np.array(places).reshape(-1, 2))
        inward = self.routes.entrance.inward
        self._heading: Array = np.full(count, math.atan2(inward[1], inward[0]))
        self._turning = np.zeros(count)
        self._velocity: Array = np.zeros((count, 2))
        self._walked = np.zeros(count)
        self._steps = 0
        self._lock = threading.Lock()  # renderer, phones and truth ask from threads of their own
        # Ring of rows (x, y, heading, speed, walked, present) per visitor, for times step · STEP.
        self._history = np.zeros((_REMEMBERED, count, 6))
        self._remember()

    @property
    def persons(self) -> Sequence[str]:
        """Visitor ids."""
        return self._persons

    def advance(self, until: float) -> None:
        """Walk on until time ``until`` has been reached or passed."""
        with self._lock:
            while self._steps * STEP < until:
                self._step()

    def snapshot(self, t: float) -> Snapshot:
        """Return everybody inside the outline at time ``t``, walking on as far as needed."""
        self.advance(t)
        rows = self._rows(np.array([t]))[0]
        index = np.flatnonzero(rows[:, 5] > 0.5)
        rows = rows[index]
        return Snapshot(
            person=[self._persons[i] for i in index],
            index=index,
            position=rows[:, :2],
            heading=rows[:, 2],
            speed=rows[:, 3],
            walked=rows[:, 4],
        )

    def motion(self, person: str, times: Array) -> Motion:
        """Return how ``person`` moved, inside or waiting outside; half a minute back at most, older times are NaN."""
        self.advance(float(times[-1]))
        rows = self._rows(times)[:, self._persons.index(person)]
        return Motion(position=rows[:, :2], heading=rows[:, 2], speed=rows[:, 3], present=rows[:, 5] > 0.5)

    def instants(self, after: float, until: float) -> Array:
        """Return the simulation's own steps in (after, until]."""
        first = max(0, math.floor(after / STEP + 1e-9) + 1)
        steps = np.arange(first, math.floor(until / STEP + 1e-9) + 1)
        chosen: Array = steps * np.float64(STEP)
        return chosen

    def _rows(self, times: Array) -> Array:
        """Interpolate the history at (n,) times: (n, people, 6)."""
        with self._lock:
            return self._interpolated(times)

    def _interpolated(self, times: Array) -> Array:
        place = np.clip(np.asarray(times, float) / STEP, 0.0, self._steps)
        before = np.minimum(np.floor(place).astype(int), max(self._steps - 1, 0))
        after = np.minimum(before + 1, self._steps)
        share = (place - before)[:, None, None]
        rows: Array = (1 - share) * self._history[before % _REMEMBERED] + share * self._history[after % _REMEMBERED]
        inside = self._plan.contains(rows[..., :2].reshape(-1, 2)).reshape(rows.shape[:2])
        rows[..., 5] = inside
        rows[before <= self._steps - _REMEMBERED] = np.nan
        return rows

    def _remember(self) -> None:
        row = self._history[self._steps % _REMEMBERED]
        row[:, :2] = self._position
        row[:, 2] = self._heading
        row[:, 3] = np.hypot(self._velocity[:, 0], self._velocity[:, 1])
        row[:, 4] = self._walked

    def _step(self) -> None:
        t = self._steps * STEP
        wanted = np.array([self._wish(number, t) for number in range(len(self._visitors))]).reshape(-1, 2)
        before = self._position.copy()
        goal = self._velocity + np.clip(wanted - self._velocity, -1.5 * STEP, 1.5 * STEP)
        self._position = self._settled(before + goal * STEP)
        self._velocity = (self._position - before) / STEP
        self._turn(wanted)
        self._walked += np.hypot(*(self._position - before).T)
        for number, visitor in enumerate(self._visitors):
            blocked = bool(visitor.path) and math.hypot(*self._velocity[number]) < 0.3 * visitor.cruise
            visitor.stuck = visitor.stuck + STEP if blocked else 0.0
        self._steps += 1
        self._remember()

    def _settled(self, position: Array) -> Array:
        """Return positions where nobody touches anybody and nobody stands in a wall; the walls have the last word."""
        for _ in range(6):
            apart = _kept_apart(position)
            inside = shapely.contains_xy(self.routes.room, apart[:, 0], apart[:, 1])
            for number in np.flatnonzero(~inside).tolist():
                apart[number] = self.routes.nearest_room(apart[number])
            if np.array_equal(apart, position):
                break
            position = apart
        return position

    def _wish(self, number: int, t: float) -> Array:
        """Return the velocity (2,) that one visitor would like to have, and move their plans on."""
        visitor, here = self._visitors[number], self._position[number]
        if not visitor.path:
            if t < visitor.wake:
                # Nobody stands like a post: weight shifts from foot to foot, a few centimetres a second.
                phase = 2.0 * math.pi * (t / 2.7 + visitor.sway)
                sideways = np.array([-math.sin(self._heading[number]), math.cos(self._heading[number])])
                shift: Array = 0.06 * math.cos(phase) * sideways + (self._others(number) if visitor.inside else 0.0)
                return shift
            self._decide(visitor, here)
        target = visitor.path[0]
        distance = math.dist(here, target)
        last = len(visitor.path) == 1
        if distance < (0.15 if last else 0.45) or (last and visitor.stuck > 1.5 and distance < 0.9):
            visitor.path.pop(0)
            if last:
                self._arrive(visitor, t)
                return np.zeros(2)
            target, distance = visitor.path[0], math.dist(here, visitor.path[0])
        if visitor.stuck > 2.5:
            visitor.stuck = 0.0
            visitor.path = self.routes.path(here, visitor.path[-1])
            target, distance = visitor.path[0], max(math.dist(here, visitor.path[0]), 1e-6)
        speed = min(visitor.cruise, 0.35 + 0.9 * distance) if len(visitor.path) == 1 else visitor.cruise
        wish = speed * (target - here) / max(distance, 1e-6) + self._others(number)
        pace = math.hypot(*wish)
        held: Array = wish if pace <= visitor.cruise else wish * (visitor.cruise / pace)
        return held

    def _decide(self, visitor: _Visitor, here: Array) -> None:
        rng = visitor.rng
        if not visitor.inside:
            visitor.inside = True
            visitor.places_left = int(rng.integers(*self._parameters.exhibits, endpoint=True))
            visitor.cruise = rng.uniform(*self._parameters.speed)
        if visitor.places_left > 0:
            visitor.places_left -= 1
            # Nearer places are likelier, occupied ones are left to the others.
            distance = np.hypot(*(self._places[:, :2] - here).T)
            taken = np.hypot(*(self._places[:, None, :2] - self._position[None]).transpose(2, 0, 1)).min(axis=1) < 0.7
            weight = np.where(taken | (distance < 1.0), 1e-6, np.exp(-distance / 6.0))
            place = self._places[rng.choice(len(self._places), p=weight / weight.sum())]
            goal, visitor.look_at = place[:2], place[2:]
        else:
            side = rng.uniform(-0.4, 0.4) * self.routes.entrance.width
            goal, visitor.look_at = self.routes.entrance.outside(side, rng.uniform(1.2, 3.4)), None
        visitor.path = self.routes.path(here, goal)
        visitor.stuck = 0.0

    def _arrive(self, visitor: _Visitor, t: float) -> None:
        if visitor.look_at is None:
            visitor.inside = False
            visitor.wake = t + visitor.rng.uniform(*self._parameters.away)
        else:
            visitor.wake = t + visitor.rng.uniform(*self._parameters.dwell)

    def _others(self, number: int) -> Array:
        """Return the push (2,) away from people near by, turned a little so that both pass on their right."""
        away = self._position[number] - self._position
        distance = np.hypot(away[:, 0], away[:, 1])
        near = (distance < _AWARE) & (distance > 1e-6)
        if not near.any():
            return np.zeros(2)
        away, distance = away[near], distance[near]
        strength = 0.9 * ((_AWARE - distance) / (_AWARE - _APART)).clip(0.0, 1.5) ** 2
        direction = away / distance[:, None]
        # Walking towards somebody, "away" points backwards; turned by -70 degrees that is a step to the right.
        facing = np.array([math.cos(self._heading[number]), math.sin(self._heading[number])])
        ahead = (-direction @ facing).clip(0.0, 1.0)[:, None]
        right = np.array([facing[1], -facing[0]])
        push: Array = (strength[:, None] * ((1.0 - 0.6 * ahead) * direction + ahead * right)).sum(axis=0)
        return push

    def _turn(self, wanted: Array) -> None:
        """Turn bodies towards where they walk, or towards what they look at, with limited rate and acceleration."""
        for number, visitor in enumerate(self._visitors):
            speed = math.hypot(*self._velocity[number])
            if visitor.path and speed > 0.15:
                target = math.atan2(self._velocity[number, 1], self._velocity[number, 0])
            elif not visitor.path and visitor.look_at is not None:
                target = math.atan2(*(visitor.look_at - self._position[number])[::-1])
            elif not visitor.path and not visitor.inside:
                inward = self.routes.entrance.inward
                target = math.atan2(inward[1], inward[0])
            else:
                target = self._heading[number]
            error = math.remainder(target - self._heading[number], math.tau)
            rate = float(np.clip(3.0 * error, -2.6, 2.6))
            self._turning[number] += float(np.clip(rate - self._turning[number], -0.8, 0.8))
            self._heading[number] += self._turning[number] * STEP


def _kept_apart(position: Array) -> Array:
    """Move people who would touch each other apart, each by half."""
    away = position[:, None] - position[None]
    distance = np.hypot(away[..., 0], away[..., 1])
    np.fill_diagonal(distance, np.inf)
    overlap = (_APART - distance).clip(0.0)
    share = 0.5 * overlap / np.maximum(distance, 1e-6)
    moved: Array = position + (share[..., None] * away).sum(axis=1)
    return moved


def _viewing_places(plan: FloorPlan, routes: Routes) -> Array:
    """Return (n, 4): places round the exhibits and the point each looks at; on a bare floor, a grid of places."""
    places = []
    for obstacle in plan.obstacles.geoms:
        ring = obstacle.buffer(0.85).exterior
        middle = np.array(obstacle.centroid.coords[0])
        for along in np.arange(0.0, ring.length, 0.9):
            place = np.array(ring.interpolate(along).coords[0])
            if np.allclose(routes.nearest_free(place), place) and plan.contains(place[None])[0]:
                places.append(np.concatenate([place, middle]))
    if not places:
        left, bottom, right, top = plan.outline.bounds
        for x in np.linspace(left, right, 8)[1:-1]:
            for y in np.linspace(bottom, top, 8)[1:-1]:
                place = np.array([x, y])
                if np.allclose(routes.nearest_free(place), place) and plan.contains(place[None])[0]:
                    places.append(np.concatenate([place, place + routes.entrance.inward]))
    if not places:
        raise ValueError("there is no place to stand on this floor")
    return np.array(places)
