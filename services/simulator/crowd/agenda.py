"""What does somebody do next? Where to go, what to look at there, and for how long.

Visitors go from exhibit to exhibit, those not yet seen first, and sometimes stop just anywhere. Workers keep a few
stations for long, walk back and forth between two places, and shuffle about while they work. Passers cross from door
to door and seldom stop. Everybody leaves in the end.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from services.simulator.crowd.floor_space import DoorPlace, FloorSpace
from services.simulator.crowd.walker_parameters import WalkerParameters

__all__ = ["Agenda", "Goal", "Mind", "cruising_speed"]

Array = NDArray[np.float64]

_APART = 0.65  # metres between the goals of two people
_OTHER_FLOOR = 0.06  # chance that the next goal of a visitor or worker is on another floor
_DOOR_DEPTH = 2.9  # metres outside of a door to where people go when they leave


@dataclass(frozen=True, slots=True)
class Goal:
    """A place to go to.

    Attributes:
        place: (2,), metres.
        dwell: seconds to stay.
        look_at: (2,), what is looked at there; None: keep facing as one came.
        exhibit: number of the exhibit looked at, -1 for none.
        door: the door one goes out by; ``place`` is outside of it.
    """

    place: Array
    dwell: float
    look_at: Array | None = None
    exhibit: int = -1
    door: DoorPlace | None = None


@dataclass(slots=True)
class Mind:
    """What one person remembers."""

    rng: np.random.Generator
    due: float = math.inf
    """When they would rather leave."""
    seen: list[int] = field(default_factory=list)
    """Exhibits, the latest last."""
    stations: list[Goal] = field(default_factory=list)
    errands: list[Goal] = field(default_factory=list)
    """Goals already decided on, the next one last."""
    came_by: str = ""
    """Id of the door."""


def cruising_speed(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    """Return somebody's usual speed: normal about the middle of the range, whose ends are two deviations away."""
    low, high = bounds
    return float(np.clip(rng.normal(0.5 * (low + high), 0.25 * (high - low)), low, high))


class Agenda:
    """The decisions of everybody on one floor; each person's own generator draws them."""

    def __init__(self, parameters: WalkerParameters, space: FloorSpace) -> None:
        self._parameters = parameters
        self._space = space

    def arrive(self, mind: Mind, t: float, door: str) -> None:
        """Begin a visit."""
        mind.due = t + mind.rng.uniform(*self._parameters.visit)
        mind.came_by = door
        mind.seen.clear()
        self.settle(mind)

    def settle(self, mind: Mind) -> None:
        """Begin on this floor: what was planned on another one is over."""
        mind.errands.clear()
        mind.stations.clear()

    def dwell(self, rng: np.random.Generator, share: float = 1.0) -> float:
        """Return seconds to stay: log-uniform over the range, or its lower ``share``."""
        low, high = self._parameters.dwell
        return float(low * (high / low) ** (share * rng.random()))

    def next_goal(self, mind: Mind, here: Array, taken: Array) -> Goal:
        """Return where to go from (2,); the places ``taken`` (m, 2) are other people's."""
        if mind.errands:
            return mind.errands.pop()
        behaviour = self._parameters.behaviour
        if behaviour == "passers":
            if mind.rng.random() < 0.05:
                return self._anywhere(mind, taken)
            return self.way_out(mind, here, any_door=True)
        links = [door for door in self._space.doors if door.door.leads_to is not None]
        if links and mind.rng.random() < _OTHER_FLOOR:
            return self._through(mind, links[int(mind.rng.integers(len(links)))])
        return self._station(mind, here, taken) if behaviour == "workers" else self._exhibit(mind, here, taken)

    def way_out(self, mind: Mind, here: Array, any_door: bool = False) -> Goal:
        """Return a door to leave by: a near one, or for who passes through a far one."""
        doors = [place for place in self._space.doors if any_door or place.door.leads_to is None] or self._space.doors
        others = [place for place in doors if place.door.id != mind.came_by]
        if any_door and others:
            doors = others
        distance = np.array([math.dist(place.middle, here) for place in doors])
        weight = (distance + 0.5) ** 1.5 if any_door else np.exp(-distance / 8.0) + 1e-9
        return self._through(mind, doors[int(mind.rng.choice(len(doors), p=weight / weight.sum()))])

    def beside(self, goal: Goal, rng: np.random.Generator, taken: Array) -> Goal:
        """Return a companion's goal next to ``goal``: before the same exhibit, or side by side."""
        if goal.door is not None:
            return Goal(self._spot(rng, goal.door), 0.0, door=goal.door)
        if goal.exhibit >= 0:
            of_it = np.flatnonzero(self._space.exhibit == goal.exhibit)
            distance = np.hypot(*(self._space.viewing[of_it] - goal.place).T)
            for choice in of_it[np.argsort(distance, kind="stable")][:7].tolist():
                if _free(self._space.viewing[choice], taken):
                    look_at = self._space.look_at[choice]
                    return Goal(self._space.viewing[choice], math.inf, look_at, goal.exhibit)
        start = rng.uniform(0.0, math.tau)
        for turn in np.arange(0.0, math.tau, math.tau / 8):
            for distance in (0.85, 1.3):
                place = goal.place + distance * np.array([math.cos(start + turn), math.sin(start + turn)])
                if self._space.is_clear(place) and _free(place, taken):
                    # Standing anywhere, companions look at each other.
                    return Goal(place, math.inf, goal.place if goal.look_at is None else goal.look_at, goal.exhibit)
        return Goal(self._free_anywhere(rng, taken), math.inf)

    def shuffle(self, mind: Mind, here: Array, home: Array) -> tuple[Array, float]:
        """Return where a step or two may take who stands at (2,) for (2,) ``home``, and seconds until the next time."""
        worker = self._parameters.behaviour == "workers"
        seconds = float(mind.rng.exponential(12.0 if worker else 20.0)) + 3.0
        reach, low, high = (0.8, 0.3, 0.8) if worker else (0.35, 0.15, 0.35)
        for _ in range(6):
            angle, distance = mind.rng.uniform(-math.pi, math.pi), mind.rng.uniform(low, high)
            place = here + distance * np.array([math.cos(angle), math.sin(angle)])
            if math.dist(place, home) <= reach and self._space.is_clear(place):
                return place, seconds
        return here, seconds

    def turn(self, mind: Mind, goal: Goal | None) -> tuple[float | None, float]:
        """Return a direction to turn to on the spot (None: back to what is looked at) and seconds until the next."""
        worker = self._parameters.behaviour == "workers"
        seconds = float(mind.rng.exponential(9.0 if worker else 6.0)) + 2.0
        if not worker and goal is not None and goal.look_at is not None and mind.rng.random() < 0.85:
            return None, seconds
        return float(mind.rng.uniform(-math.pi, math.pi)), seconds if worker else 2.0

    def _exhibit(self, mind: Mind, here: Array, taken: Array) -> Goal:
        space, rng = self._space, mind.rng
        if not len(space.viewing) or rng.random() < self._parameters.anywhere:
            return self._anywhere(mind, taken)
        distance = np.hypot(*(space.viewing - here).T)
        weight = np.exp(-distance / 8.0)
        counts = np.bincount(space.exhibit)
        weight /= np.sqrt(counts[space.exhibit])
        recent = mind.seen[-max(1, space.exhibits - 1) :]
        weight[np.isin(space.exhibit, recent)] *= 0.04
        # Everybody's goal is a place where somebody stands or soon will.
        weight[space.viewing_near(taken, _APART)] *= 1e-9
        choice = int(rng.choice(len(weight), p=weight / weight.sum()))
        if not _free(space.viewing[choice], taken):
            return self._anywhere(mind, taken)
        exhibit = int(space.exhibit[choice])
        mind.seen = [*mind.seen[-20:], exhibit]
        return Goal(space.viewing[choice], self.dwell(rng), space.look_at[choice], exhibit)

    def _station(self, mind: Mind, here: Array, taken: Array) -> Goal:
        rng = mind.rng
        if rng.random() < 0.35:
            # Back and forth: fetch and carry between here and a place some metres away.
            goal = self._anywhere(mind, taken, near=here, within=6.0)
            back = Goal(here, self.dwell(rng, 0.5))
            for _ in range(int(rng.integers(1, 4))):
                mind.errands += [back, Goal(goal.place, float(rng.uniform(2.0, 10.0)), goal.look_at)]
            return mind.errands.pop()
        if len(mind.stations) < 3 or rng.random() < 0.2:
            viewing = self._space.viewing
            if len(viewing) and rng.random() > self._parameters.anywhere:
                choice = int(rng.integers(len(viewing)))
                station = Goal(viewing[choice], 0.0, self._space.look_at[choice], int(self._space.exhibit[choice]))
            else:
                station = Goal(self._free_anywhere(rng, taken), 0.0)
            mind.stations = [*mind.stations[-2:], station]
        free = [one for one in mind.stations if _free(one.place, taken) and math.dist(one.place, here) > 1.0]
        if not free:
            return Goal(self._free_anywhere(rng, taken), self.dwell(rng))
        chosen = free[int(rng.integers(len(free)))]
        return Goal(chosen.place, self.dwell(rng), chosen.look_at, chosen.exhibit)

    def _anywhere(self, mind: Mind, taken: Array, near: Array | None = None, within: float = math.inf) -> Goal:
        place = self._free_anywhere(mind.rng, taken, near, within)
        look_at = self._space.random_place(mind.rng)
        return Goal(place, self.dwell(mind.rng, 0.6), look_at)

    def _free_anywhere(
        self, rng: np.random.Generator, taken: Array, near: Array | None = None, within: float = math.inf
    ) -> Array:
        place = self._space.random_place(rng)
        for _ in range(12):
            if _free(place, taken) and (near is None or 1.5 < math.dist(place, near) < within):
                break
            place = self._space.random_place(rng)
        return place

    def _through(self, mind: Mind, door: DoorPlace) -> Goal:
        return Goal(self._spot(mind.rng, door), 0.0, door=door)

    def _spot(self, rng: np.random.Generator, door: DoorPlace) -> Array:
        return self._space.nearest_clear(door.spot(rng, _DOOR_DEPTH))


def _free(place: Array, taken: Array) -> bool:
    return not len(taken) or bool(np.hypot(*(taken - place).T).min() >= _APART)
