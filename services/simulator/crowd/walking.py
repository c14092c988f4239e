"""How do people get to where they want to go? Ways round obstacles, corner after corner, at their pace, giving way.

What anybody wants is decided elsewhere: this is told goals, and tells who arrived and who does not get on.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from services.simulator.crowd.agenda import Goal
from services.simulator.crowd.avoidance import Avoidance
from services.simulator.crowd.bodies import Bodies
from services.simulator.crowd.floor_space import FloorSpace
from services.simulator.crowd.pace import Pace
from services.simulator.crowd.walker_parameters import WalkerParameters
from services.simulator.seeds import generator

__all__ = ["AWAY", "BETWEEN", "STANDING", "STEP", "WALKING", "Walking"]

Array = NDArray[np.float64]

STEP = 0.1
"""Seconds between two steps of the crowd; in between, positions are interpolated."""
AWAY, STANDING, WALKING, BETWEEN = range(4)
"""What somebody is doing; BETWEEN two floors they are known and on neither."""

_REACHED = 0.22  # metres
_PASSED = 0.6  # metres from a corner of the way at which the next one is headed for
_LEG = 3.5  # metres of a straight way after which it wanders
_WANDER = 0.25  # standard deviation of that, metres
_ACCELERATION = 2.5  # m/s² at most, when somebody sets off
_STUCK, _GIVE_UP = 2.0, 6.0  # seconds


class Walking:
    """Everybody on their feet.

    Args:
        spaces: the floors by id.
        rngs: of each of the p people.
        cruise: usual speed of each, (p,), m/s.
        parameters: how they walk.
        seed: of the world.

    Attributes:
        doing: (p,), AWAY, STANDING, WALKING or BETWEEN.
        floor: (p,), number of the floor, -1 for who is away.
        present: (p,), whether inside the outline.
        goal: of each, while they are about.
        place: (p, 2), of the goals: taken, for everybody else; NaN for who is away.
        here: (p, 2), where they are, without sway.
        facing: (p,), where they face while they stand, radians.
        pace: their wished speeds.
        bodies: where their bodies are.
    """

    def __init__(
        self,
        spaces: Mapping[str, FloorSpace],
        rngs: Sequence[np.random.Generator],
        cruise: Array,
        parameters: WalkerParameters,
        seed: int,
    ) -> None:
        count = len(rngs)
        self._spaces, self._rngs = list(spaces.values()), rngs
        self._traffic = [
            Avoidance(
                space.room, int(generator(seed, "crowd", "avoidance", floor).integers(2**63)), parameters.present[1]
            )
            for floor, space in spaces.items()
        ]
        self.pace = Pace(cruise.copy(), parameters.behaviour, seed)
        self.bodies = Bodies(count, seed, STEP)
        self.doing = np.zeros(count, np.int8)
        self.floor = np.full(count, -1, np.int16)
        self.present = np.zeros(count, bool)
        self.goal: list[Goal | None] = [None] * count
        self.place = np.full((count, 2), np.nan)
        self.here = np.zeros((count, 2))
        self.facing = np.full(count, np.nan)
        self._way: list[list[Array]] = [[] for _ in range(count)]  # corners after the target
        self._target = np.full((count, 2), np.nan)
        self._rest = np.zeros(count)  # metres of the way after the target
        self._last_leg = np.zeros(count, bool)
        self._slow = np.full(count, math.inf)  # limit of the speed of a step or two
        self._wished = np.zeros(count)
        self._stuck = np.zeros(count)

    def put(self, person: int, floor: int, spot: Array, heading: float) -> bool:
        """Let a person stand at (2,), and say whether there was room."""
        if not self._traffic[floor].add(person, spot):
            return False
        self.bodies.appear(person, spot, heading)
        self.here[person] = self._target[person] = self.place[person] = spot
        self.doing[person], self.floor[person] = STANDING, floor
        self.facing[person] = heading
        return True

    def remove(self, person: int) -> None:
        """Take a person off the floor."""
        self._traffic[self.floor[person]].remove(person)
        self.doing[person], self.floor[person], self.present[person] = AWAY, -1, False
        self.goal[person], self.place[person], self._target[person] = None, np.nan, np.nan

    def set_off(self, person: int, goal: Goal) -> None:
        """Walk to a goal."""
        self.goal[person], self.place[person] = goal, goal.place
        self.doing[person], self._slow[person], self._stuck[person] = WALKING, math.inf, 0.0
        self._plan(person)

    def shift(self, person: int, place: Array) -> None:
        """Take a step or two to (2,), without another goal."""
        self.doing[person], self._slow[person] = WALKING, 0.55
        self._way[person] = []
        self._aim(person, self._spaces[self.floor[person]].nearest_clear(place))

    def shuffles(self, person: int) -> bool:
        """Whether somebody only takes a step or two."""
        return self.doing[person] == WALKING and math.isfinite(self._slow[person])

    def stand(self, person: int) -> None:
        """Stay here."""
        self.doing[person], self._slow[person], self._stuck[person] = STANDING, math.inf, 0.0
        self._target[person] = self.here[person]
        self._traffic[self.floor[person]].aim(person, self.here[person])

    def face_goal(self, person: int) -> None:
        """Face what is looked at here."""
        goal = self.goal[person]
        if goal is None or goal.look_at is None or math.dist(goal.look_at, self.here[person]) < 0.05:
            self.facing[person] = self.bodies.heading[person]
        else:
            away = goal.look_at - self.here[person]
            self.facing[person] = math.atan2(away[1], away[0])

    def taken(self, person: int) -> Array:
        """Return the goals of everybody else on this person's floor, (m, 2)."""
        others = (self.floor == self.floor[person]) & ~np.isnan(self.place[:, 0])
        others[person] = False
        places: Array = self.place[others]
        return places

    def arrivals(self) -> list[int]:
        """Head for the next corners; return who has reached their goal, or the end of a step or two."""
        arrived = []
        walking = np.flatnonzero(self.doing == WALKING)
        distance = np.hypot(*(self._target[walking] - self.here[walking]).T)
        for person in walking[distance < _PASSED].tolist():
            if self._way[person]:
                self._aim(person, self._way[person].pop(0))
            elif math.dist(self._target[person], self.here[person]) < _REACHED:
                arrived.append(person)
        return arrived

    def hindered(self) -> list[int]:
        """Let who does not get on find another way or ask for room; return who has tried for long."""
        walking = self.doing == WALKING
        slow = walking & (self.bodies.speed < 0.2 * np.minimum(self.pace.cruise, self._slow))
        freed = np.where(walking, np.maximum(self._stuck - 2.0 * STEP, 0.0), 0.0)
        self._stuck = np.where(slow, self._stuck + STEP, freed)
        tried = []
        for person in np.flatnonzero(self._stuck > _STUCK).tolist():
            if self._stuck[person] > _GIVE_UP:
                self._stuck[person] = 0.0
                tried.append(person)
            elif self._stuck[person] % 1.0 < STEP:
                self._ask_for_room(person)
                if not self.shuffles(person):
                    self._plan(person, wander=1.6)
        return tried

    def advance(self, groups: Iterable[Sequence[int]]) -> None:
        """Let one step's time pass; the members of each of ``groups`` keep abreast."""
        walking = self.doing == WALKING
        wished = np.where(walking, np.minimum(self.pace.next(walking, STEP), self._slow), 0.0)
        left = np.hypot(*(self._target - self.here).T)
        wished = np.where(walking & self._last_leg, np.minimum(wished, 0.3 + 0.9 * left), wished)
        for members in groups:
            together = [person for person in members if walking[person] and math.isinf(self._slow[person])]
            if len(together) > 1:
                behind = left[together] + self._rest[together]
                wished[together] *= np.clip(1.0 + 0.3 * (behind - behind.mean()), 0.6, 1.25)
        self._wished = np.minimum(wished, self._wished + _ACCELERATION * STEP)
        for floor, traffic in enumerate(self._traffic):
            persons = self._about(floor).tolist()
            traffic.pace(persons, self._wished[persons].tolist())
            traffic.walk(STEP)
            if persons:
                self.here[persons] = traffic.positions(persons)
        self.bodies.step(self.here, np.where(walking & np.isinf(self._slow), np.nan, self.facing))
        for floor, space in enumerate(self._spaces):
            persons = self._about(floor)
            body = self.bodies.position[persons]
            fits = shapely.contains_xy(space.bodies, body[:, 0], body[:, 1])
            for person in persons[~fits].tolist():
                self.bodies.position[person] = space.nearest_body(self.bodies.middle[person])
            self.present[persons] = space.plan.contains(self.bodies.position[persons])

    def _about(self, floor: int) -> NDArray[np.int64]:
        return np.flatnonzero((self.floor == floor) & ((self.doing == STANDING) | (self.doing == WALKING)))

    def _plan(self, person: int, wander: float = 1.0) -> None:
        """Find a way, wandering about the straight one."""
        space, rng = self._spaces[self.floor[person]], self._rngs[person]
        here: Array = self.here[person]
        corners: list[Array] = []
        for corner in space.path(here, self.place[person]):
            legs = int(math.dist(here, corner) // _LEG)
            for leg in range(1, legs + 1):
                point = here + (corner - here) * leg / (legs + 1) + rng.normal(0.0, _WANDER * wander, 2)
                if space.is_clear(point):
                    corners.append(point)
            corners.append(corner)
            here = corner
        self._way[person] = corners
        self._aim(person, corners.pop(0))

    def _aim(self, person: int, target: Array) -> None:
        self._target[person] = target
        way, goal = [target, *self._way[person]], self.goal[person]
        # People brake before a goal, not before a door they go through.
        self._last_leg[person] = len(way) == 1 and (goal is None or goal.door is None)
        self._rest[person] = sum(math.dist(a, b) for a, b in itertools.pairwise(way))
        self._traffic[self.floor[person]].aim(person, target)

    def _ask_for_room(self, person: int) -> None:
        """Let the nearest who stands in the way make a step aside."""
        others = np.flatnonzero((self.floor == self.floor[person]) & (self.doing == STANDING))
        if not len(others):
            return
        away = self.here[others] - self.here[person]
        distance = np.hypot(away[:, 0], away[:, 1])
        nearest = int(distance.argmin())
        if distance[nearest] < 1.0:
            aside = np.array([-away[nearest, 1], away[nearest, 0]]) / max(distance[nearest], 1e-6)
            side = 1.0 if self._rngs[person].random() < 0.5 else -1.0
            self.shift(int(others[nearest]), self.here[others[nearest]] + side * 0.6 * aside)
