"""A seeded crowd on the floors of a site: who is where at any time, from the world's first second on.

What people want comes from ``agenda``, how fast they would walk from ``pace``, who gives way to whom from JuPedSim
(``avoidance``), who comes and goes from ``admission``, and what bodies do on their way from ``bodies``. Steps are
fixed and every part draws from a generator of its own: the same seed walks the same way however often time is asked
for, and in every process.
"""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Mapping, Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from services.simulator.admission import Admission
from services.simulator.agenda import Agenda, Goal, Mind, cruising_speed
from services.simulator.avoidance import Avoidance
from services.simulator.bodies import Bodies
from services.simulator.companions import Companions
from services.simulator.floor_space import DoorPlace, FloorSpace
from services.simulator.pace import Pace
from services.simulator.people import Movement
from services.simulator.seeds import generator
from services.simulator.walk_history import WalkHistory
from services.simulator.walker_parameters import Door, WalkerParameters
from shared.site import FloorPlan

__all__ = ["STEP", "Crowd", "Door", "WalkerParameters"]

Array = NDArray[np.float64]

STEP = 0.1
"""Seconds between two steps of the crowd; in between, positions are interpolated."""

_BEFORE = 200  # steps walked before the world begins: its first moment is one of many
_AWAY, _STANDING, _WALKING, _BETWEEN = range(4)
_REACHED = 0.22  # metres
_PASSED = 0.6  # metres from a corner of the way at which the next one is headed for
_LEG = 3.5  # metres of a straight way after which it wanders
_WANDER = 0.25  # standard deviation of that, metres
_STUCK, _GIVE_UP = 2.0, 6.0  # seconds


class Crowd:
    """People who walk on the plans of one or more floors (the ``People`` of a simulated world).

    Args:
        plans: the floors by id.
        parameters: who they are and what they do.
        seed: of everything.

    Raises:
        ValueError: nobody could walk or come in here, or a door is where none can be.
    """

    def __init__(self, plans: Mapping[str, FloorPlan], parameters: WalkerParameters, seed: int) -> None:
        self._parameters = parameters
        self._floors = tuple(plans)
        self._spaces = _spaces(plans, parameters)
        self._agendas = [Agenda(parameters, space) for space in self._spaces]
        self._doors = {door.door.id: (number, door) for number, s in enumerate(self._spaces) for door in s.doors}
        self._persons = tuple(f"person-{number}" for number in range(1, parameters.pool + 1))
        self._traffic = [
            Avoidance(space.room, int(generator(seed, "crowd", "avoidance", floor).integers(2**63)))
            for floor, space in zip(self._floors, self._spaces, strict=True)
        ]
        count = len(self._persons)
        self._minds = [Mind(generator(seed, "walker", person)) for person in self._persons]
        cruise = np.array([cruising_speed(mind.rng, parameters.speed) for mind in self._minds])
        self._cruise = cruise.copy()
        self._pace = Pace(cruise.copy(), parameters.behaviour, seed)
        self._bodies = Bodies(count, seed, STEP)
        self._companions = Companions()
        self._admission = Admission(parameters, seed)
        self._history = WalkHistory(count, STEP)
        self._lock = threading.Lock()  # renderer, phones and truth ask from threads of their own
        self._step_number = -_BEFORE

        self._doing = np.zeros(count, np.int8)
        self._floor = np.full(count, -1, np.int16)
        self._present = np.zeros(count, bool)
        self._wake = np.full(count, math.inf)
        self._goal: list[Goal | None] = [None] * count
        self._place = np.full((count, 2), np.nan)  # of the goal: taken, for the others
        self._way: list[list[Array]] = [[] for _ in range(count)]  # corners after the target
        self._target = np.full((count, 2), np.nan)
        self._rest = np.zeros(count)  # metres of the way after the target
        self._last_leg = np.zeros(count, bool)
        self._slow = np.full(count, math.inf)  # limit of the speed of a shuffle
        self._stuck = np.zeros(count)
        self._raw = np.zeros((count, 2))
        self._facing = np.full(count, np.nan)
        self._shuffle = np.full(count, math.inf)
        self._turn = np.full(count, math.inf)
        self._waiting: dict[int, Goal] = {}  # companions who set off in a moment
        self._arrival: dict[int, tuple[DoorPlace, int, float]] = {}  # between floors: door, floor, half-way time
        self._gone = np.zeros(count, bool)  # past the door, still seen for a step or two
        self._queue: list[tuple[int, int, DoorPlace, float]] = []  # outside: person, floor, door, since when
        self._populate()
        while self._step_number < 0:
            self._step()
        self._remember()

    @property
    def persons(self) -> Sequence[str]:
        """``person-1``, ``person-2``, …; the first ones carry phones."""
        return self._persons

    @property
    def floors(self) -> Sequence[str]:
        """Ids of the floors."""
        return self._floors

    def movement(self, times: Array, persons: Sequence[int] | NDArray[np.int64] | None = None) -> Movement:
        """Return how people moved at increasing ``times`` (n,), walking on as far as needed.

        What lies more than a minute and a half ago is unknown (NaN, -1).
        """
        times = np.asarray(times, float)
        index = None if persons is None else np.asarray(persons, dtype=np.int64)
        with self._lock:
            needed = self._history.needed(float(times[-1])) if len(times) else 0
            while self._step_number < needed:
                self._step()
                self._remember()
            moved = self._history.movement(times, index)
        for number, space in enumerate(self._spaces):
            # Between two steps somebody may have crossed the door's line.
            there = moved.present & (moved.floor == number)
            moved.present[there] &= space.plan.contains(moved.position[there])
        return moved

    def instants(self, after: float, until: float) -> Array:
        """Return the crowd's own steps in (after, until]."""
        first = max(0, math.floor(after / STEP + 1e-9) + 1)
        chosen: Array = np.arange(first, math.floor(until / STEP + 1e-9) + 1) * np.float64(STEP)
        return chosen

    # One step

    def _step(self) -> None:
        t = self._step_number * STEP
        self._look(t)
        self._reach(t)
        for person in np.flatnonzero(self._wake <= t).tolist():
            self._wakes(person, t)
        self._fidget(t)
        if self._step_number % 5 == 0:
            self._come_and_go(t)
        self._speed()
        for traffic in self._traffic:
            traffic.walk(STEP)
        self._step_number += 1
        self._move()

    def _about(self, floor: int) -> NDArray[np.int64]:
        return np.flatnonzero((self._floor == floor) & ((self._doing == _STANDING) | (self._doing == _WALKING)))

    def _look(self, t: float) -> None:
        """Take note of who does not get on."""
        walking = self._doing == _WALKING
        wished = np.minimum(self._pace.cruise, self._slow)
        slow = walking & (self._bodies.speed < 0.2 * wished)
        self._stuck = np.where(
            slow, self._stuck + STEP, np.where(walking, np.maximum(self._stuck - 2 * STEP, 0.0), 0.0)
        )
        for person in np.flatnonzero(self._stuck > _STUCK).tolist():
            if self._stuck[person] > _GIVE_UP:
                self._give_up(person, t)
            elif self._stuck[person] % 1.0 < STEP:
                self._ask_for_room(person)
                self._plan(person, self._place[person], wander=1.6)

    def _reach(self, t: float) -> None:
        """Head for the next corner, or arrive."""
        walking = np.flatnonzero(self._doing == _WALKING)
        distance = np.hypot(*(self._target[walking] - self._raw[walking]).T)
        for person, away in zip(walking.tolist(), distance.tolist(), strict=True):
            goal = self._goal[person]
            if goal is not None and goal.door is not None and not self._passes(person, goal.door):
                self._think_again(person)
            elif self._way[person]:
                if away < _PASSED:
                    self._aim(person, self._way[person].pop(0))
            elif away < _REACHED:
                self._arrived(person, t)

    def _speed(self) -> None:
        walking = self._doing == _WALKING
        wished = np.where(walking, np.minimum(self._pace.next(walking, STEP), self._slow), 0.0)
        left = np.hypot(*(self._target - self._raw).T)
        # Braking before the goal, not before a door one goes through.
        wished = np.where(walking & self._last_leg, np.minimum(wished, 0.3 + 0.9 * left), wished)
        for members in self._companions.groups():
            together = [person for person in members if walking[person] and math.isinf(self._slow[person])]
            if len(together) > 1:
                behind = left[together] + self._rest[together]
                wished[together] *= np.clip(1.0 + 0.45 * (behind - behind.mean()), 0.45, 1.35)
        for floor, traffic in enumerate(self._traffic):
            persons = self._about(floor)
            traffic.pace(persons.tolist(), wished[persons].tolist())

    def _move(self) -> None:
        for floor, traffic in enumerate(self._traffic):
            persons = self._about(floor)
            if len(persons):
                self._raw[persons] = traffic.positions(persons.tolist())
        self._bodies.step(self._raw, np.where((self._doing == _WALKING) & np.isinf(self._slow), np.nan, self._facing))
        for floor, space in enumerate(self._spaces):
            persons = self._about(floor)
            here = self._bodies.position[persons]
            fits = shapely.contains_xy(space.bodies, here[:, 0], here[:, 1])
            for person in persons[~fits].tolist():
                middle = self._bodies.middle[person]
                self._bodies.position[person] = space.nearest_body(middle)
            self._present[persons] = space.plan.contains(self._bodies.position[persons])

    def _remember(self) -> None:
        t = self._step_number * STEP
        floor = self._floor.copy()
        bodies = self._bodies
        position = bodies.position
        for person, (door, there, half) in self._arrival.items():
            if t >= half:
                floor[person] = there
                position[person] = door.middle
        rows = np.column_stack([position, bodies.heading, bodies.speed, bodies.walked])
        self._history.record(rows, floor, self._present.copy())

    # What one person does

    def _wakes(self, person: int, t: float) -> None:
        self._wake[person] = math.inf
        if self._doing[person] == _WALKING and math.isfinite(self._slow[person]):
            self._wake[person] = t + 0.3  # in the middle of a step or two
            return
        if self._doing[person] == _BETWEEN:
            door, floor, _ = self._arrival[person]
            if not self._enter(person, floor, door):
                self._wake[person] = t + 0.5
                return
            del self._arrival[person]
            self._agendas[floor].settle(self._minds[person])
            self._decide(person, t)
            return
        if self._doing[person] != _STANDING:
            return
        if person in self._waiting:
            self._set_off(person, self._waiting.pop(person))
            return
        self._decide(person, t)

    def _decide(self, person: int, t: float) -> None:
        """Choose where to go; whoever leads takes the companions along."""
        mind, agenda = self._minds[person], self._agendas[self._floor[person]]
        leader = self._companions.leader(person)
        if leader is not None and leader != person:
            if self._floor[leader] == self._floor[person] and self._goal[leader] is not None:
                self._set_off(person, self._beside(person, leader))
                return
            if self._doing[leader] == _BETWEEN or any(leader == one for one, *_ in self._queue):
                self._companions.lead(person)
            else:
                self._part(person, t)
        elif leader == person and mind.rng.random() < self._parameters.split:
            for other in self._companions.of(person):
                if other != person:
                    self._part(other, t)
        here = self._raw[person]
        leaves = self._parameters.behaviour != "passers" and t >= mind.due
        if leaves and not self._may_go(person):
            mind.due, leaves = t + mind.rng.uniform(20.0, 60.0), False
        goal = agenda.way_out(mind, here) if leaves else agenda.next_goal(mind, here, self._taken(person))
        self._set_off(person, goal)
        for other in self._companions.of(person):
            if other != person and self._doing[other] in (_STANDING, _WALKING):
                if self._floor[other] != self._floor[person]:
                    continue
                beside = self._beside(other, person)
                self._minds[other].due = max(self._minds[other].due, mind.due)
                if self._doing[other] == _WALKING:
                    self._set_off(other, beside)
                else:
                    self._place[other] = beside.place
                    self._waiting[other] = beside
                    self._wake[other] = t + self._minds[other].rng.uniform(0.0, 1.2)

    def _beside(self, person: int, leader: int) -> Goal:
        goal = self._goal[leader]
        if goal is None:  # not asked for before the leader knows where to go
            goal = Goal(self._raw[leader], 0.0)
        agenda: Agenda = self._agendas[self._floor[person]]
        return agenda.beside(goal, self._minds[person].rng, self._taken(person))

    def _taken(self, person: int) -> Array:
        """Return the goals of everybody else on this person's floor, (m, 2)."""
        others = (self._floor == self._floor[person]) & ~np.isnan(self._place[:, 0])
        others[person] = False
        places: Array = self._place[others]
        return places

    def _set_off(self, person: int, goal: Goal) -> None:
        self._goal[person], self._place[person] = goal, goal.place
        self._doing[person] = _WALKING
        self._wake[person] = self._shuffle[person] = self._turn[person] = self._slow[person] = math.inf
        self._stuck[person] = 0.0
        self._plan(person, goal.place)

    def _plan(self, person: int, place: Array, wander: float = 1.0) -> None:
        """Find a way, wandering about the straight one."""
        space, rng = self._spaces[self._floor[person]], self._minds[person].rng
        here, corners = self._raw[person], []
        for corner in space.path(here, place):
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
        way = [target, *self._way[person]]
        goal = self._goal[person]
        self._last_leg[person] = len(way) == 1 and (goal is None or goal.door is None)
        self._rest[person] = sum(math.dist(a, b) for a, b in itertools.pairwise(way))
        self._traffic[self._floor[person]].aim(person, target)

    def _arrived(self, person: int, t: float) -> None:
        goal = self._goal[person]
        self._slow[person] = math.inf
        if goal is not None and goal.door is not None:
            self._go_out(person, goal.door, t)
            return
        self._stand(person, t, goal.dwell if goal is not None and math.isinf(self._wake[person]) else None)

    def _stand(self, person: int, t: float, dwell: float | None) -> None:
        """Stay; ``dwell`` None: as long as decided before."""
        mind, goal = self._minds[person], self._goal[person]
        self._doing[person] = _STANDING
        self._target[person] = self._raw[person]
        self._traffic[self._floor[person]].aim(person, self._raw[person])
        if dwell is None:
            return
        leader = self._companions.leader(person)
        if math.isinf(dwell) and (leader is None or leader == person):
            dwell = self._agendas[self._floor[person]].dwell(mind.rng)
        self._wake[person] = t + dwell
        self._facing[person] = self._look_direction(person, goal)
        self._shuffle[person] = t + 3.0 + mind.rng.exponential(12.0)
        self._turn[person] = t + 2.0 + mind.rng.exponential(8.0)

    def _look_direction(self, person: int, goal: Goal | None) -> float:
        if goal is None or goal.look_at is None or math.dist(goal.look_at, self._raw[person]) < 0.05:
            return float(self._bodies.heading[person])
        away = goal.look_at - self._raw[person]
        return math.atan2(away[1], away[0])

    def _fidget(self, t: float) -> None:
        """Standing people turn on the spot and take a step or two."""
        standing = self._doing == _STANDING
        for person in np.flatnonzero(standing & (self._turn <= t)).tolist():
            goal = self._goal[person]
            towards, seconds = self._agendas[self._floor[person]].turn(self._minds[person], goal)
            self._facing[person] = self._look_direction(person, goal) if towards is None else towards
            self._turn[person] = t + seconds
        for person in np.flatnonzero(standing & (self._shuffle <= t)).tolist():
            place, seconds = self._agendas[self._floor[person]].shuffle(
                self._minds[person], self._raw[person], self._place[person]
            )
            self._shuffle[person] = t + seconds
            self._shift(person, place)

    def _shift(self, person: int, place: Array) -> None:
        """Take a step or two to (2,), the goal and the time to go on staying as they are."""
        self._doing[person], self._slow[person] = _WALKING, 0.55
        self._way[person] = []
        self._aim(person, self._spaces[self._floor[person]].nearest_clear(place))

    def _ask_for_room(self, person: int) -> None:
        """Let the nearest who stands in the way make a step aside."""
        others = self._about(int(self._floor[person]))
        others = others[(self._doing[others] == _STANDING) & (others != person)]
        if not len(others):
            return
        away = self._raw[others] - self._raw[person]
        distance = np.hypot(away[:, 0], away[:, 1])
        nearest = int(distance.argmin())
        if distance[nearest] < 1.0:
            aside = np.array([-away[nearest, 1], away[nearest, 0]]) / max(distance[nearest], 1e-6)
            sign = 1.0 if self._minds[person].rng.random() < 0.5 else -1.0
            self._shift(int(others[nearest]), self._raw[others[nearest]] + sign * 0.6 * aside)

    def _give_up(self, person: int, t: float) -> None:
        """Be content with here, or choose another goal."""
        goal = self._goal[person]
        self._stuck[person] = 0.0
        if math.isfinite(self._slow[person]):
            self._slow[person] = math.inf
            self._stand(person, t, None)
        elif goal is not None and goal.door is not None and self._gone[person] and not self._present[person]:
            self._go_out(person, goal.door, t)
        elif goal is None or goal.door is not None or not self._present[person]:
            self._think_again(person)
        else:
            self._place[person] = self._raw[person]
            self._stand(person, t, min(goal.dwell, 5.0) if math.isfinite(goal.dwell) else math.inf)

    # Coming and going

    def _may_go(self, person: int) -> bool:
        """Whether enough people stay if this one goes."""
        there = int((self._present & ~self._gone).sum())
        return not self._present[person] or there - 1 >= self._parameters.present[0]

    def _passes(self, person: int, door: DoorPlace) -> bool:
        """Whether a person on the way to a door may go on; refused at the door, where too few would stay."""
        if not door.outside or self._gone[person] or not self._present[person]:
            return True
        if float((self._raw[person] - door.middle) @ door.inward) > 0.6:
            return True
        self._gone[person] = self._may_go(person)
        return bool(self._gone[person])

    def _think_again(self, person: int) -> None:
        """Choose another goal, alone, and stay for a while before leaving is thought of again."""
        mind, t = self._minds[person], self._step_number * STEP
        self._part(person, t)
        self._gone[person] = False
        mind.due = max(mind.due, t + mind.rng.uniform(60.0, 180.0))
        agenda = self._agendas[self._floor[person]]
        self._set_off(person, agenda.next_goal(mind, self._raw[person], self._taken(person)))

    def _go_out(self, person: int, door: DoorPlace, t: float) -> None:
        if not self._gone[person] and not self._may_go(person):
            self._think_again(person)
            return
        if door.door.leads_to is None:
            self._leave(person)
            self._admission.left(person, t)
            return
        there, other = self._doors[door.door.leads_to]
        seconds = door.door.seconds * self._minds[person].rng.uniform(0.8, 1.2)
        floor = self._floor[person]
        self._leave(person, keep_company=True)
        self._doing[person], self._floor[person] = _BETWEEN, floor
        self._arrival[person] = (other, there, t + 0.5 * seconds)
        self._wake[person] = t + max(seconds, STEP)

    def _leave(self, person: int, keep_company: bool = False) -> None:
        self._traffic[self._floor[person]].remove(person)
        self._doing[person], self._floor[person], self._present[person] = _AWAY, -1, False
        self._goal[person], self._place[person], self._target[person] = None, np.nan, np.nan
        self._wake[person] = self._shuffle[person] = self._turn[person] = math.inf
        self._gone[person] = False
        self._waiting.pop(person, None)
        if not keep_company:
            for other in self._companions.leave(person):
                self._wake[other] = min(self._wake[other], self._step_number * STEP + 2.0)

    def _part(self, person: int, t: float) -> None:
        """Go one's own way from now on."""
        self._pace.cruise[person] = self._cruise[person]
        for other in [person, *self._companions.leave(person)]:
            if self._doing[other] == _STANDING and math.isinf(self._wake[other]):
                self._wake[other] = t + self._minds[other].rng.uniform(0.5, 6.0)

    def _enter(self, person: int, floor: int, door: DoorPlace) -> bool:
        """Let a person appear at a door if there is room; they have no goal yet."""
        rng, space = self._minds[person].rng, self._spaces[floor]
        spot = space.nearest_clear(door.spot(rng, rng.uniform(2.0, 2.9)))
        heading = math.atan2(door.inward[1], door.inward[0]) if door.outside else rng.uniform(-math.pi, math.pi)
        return self._put(person, floor, spot, heading)

    def _put(self, person: int, floor: int, spot: Array, heading: float) -> bool:
        if not self._traffic[floor].add(person, spot):
            return False
        self._bodies.appear(person, spot, heading)
        self._raw[person] = self._target[person] = self._place[person] = spot
        self._doing[person], self._floor[person] = _STANDING, floor
        self._facing[person] = heading
        return True

    def _come_and_go(self, t: float) -> None:
        """Twice a second: let in who waits, call who is missing, ask to go who is too many."""
        for entry in list(self._queue):
            person, floor, door, since = entry
            if self._enter(person, floor, door):
                self._queue.remove(entry)
                self._agendas[floor].arrive(self._minds[person], t, door.door.id)
                self._decide(person, t)
            elif t - since > 20.0:
                self._queue.remove(entry)
                self._companions.leave(person)
        there = self._doing != _AWAY
        coming = int((there & ~self._present & ~self._gone).sum()) + len(self._queue)
        seen = int(self._present.sum())
        dues = np.array([mind.due for mind in self._minds])
        leaving = there & (dues <= t)
        staying = int((there & ~leaving & ~self._gone).sum()) + len(self._queue)
        wanted = self._admission.wanted(5 * STEP)
        most = min(wanted - staying + 1, self._parameters.present[1] - seen - coming)
        if staying < wanted and most > 0:
            away = ~there
            away[[one for one, *_ in self._queue]] = False
            self._call(self._admission.next(t, away, most), t)
        elif staying > wanted and self._parameters.behaviour != "passers":
            candidates = np.flatnonzero(there & ~leaving & self._present)
            candidates = candidates[np.argsort(dues[candidates], kind="stable")]
            others = [one for one in candidates.tolist() if one >= self._parameters.carriers]
            if others:
                self._minds[others[0]].due = t
                self._wake[others[0]] = min(self._wake[others[0]], t + self._admission.rng.uniform(0.0, 15.0))

    def _call(self, persons: Sequence[int], t: float) -> None:
        """Let people come in together by one door."""
        doors = [(floor, door) for floor, space in enumerate(self._spaces) for door in space.doors]
        doors = [(floor, door) for floor, door in doors if door.door.leads_to is None] or doors
        widths = np.array([door.door.width for _, door in doors])
        floor, door = doors[int(self._admission.rng.choice(len(doors), p=widths / widths.sum()))]
        self._queue += [(person, floor, door, t) for person in persons]
        self._together(persons)

    def _together(self, persons: Sequence[int]) -> None:
        self._companions.form(persons)
        if len(persons) > 1:
            self._pace.cruise[list(persons)] = self._cruise[list(persons)].mean()

    def _populate(self) -> None:
        """Begin in the middle of things: people stand and walk about, alone and in groups."""
        t, rng = self._step_number * STEP, self._admission.rng
        persons = self._admission.first(self._admission.wanted(0.0))
        areas = np.array([space.inside.area if space.doors else 0.0 for space in self._spaces])
        while persons:
            size = min(self._admission.group_size(), len(persons))
            members, persons = persons[:size], persons[size:]
            floor = int(rng.choice(len(areas), p=areas / areas.sum()))
            placed = []
            for person in members:
                mind, space = self._minds[person], self._spaces[floor]
                for _ in range(50):
                    spot = space.random_place(mind.rng)
                    if self._put(person, floor, spot, mind.rng.uniform(-math.pi, math.pi)):
                        placed.append(person)
                        self._agendas[floor].arrive(mind, t, "")
                        mind.due = t + mind.rng.uniform(0.0, self._parameters.visit[1])
                        self._wake[person] = t + mind.rng.uniform(0.0, 15.0)
                        self._present[person] = True
                        break
            self._together(placed)


def _spaces(plans: Mapping[str, FloorPlan], parameters: WalkerParameters) -> list[FloorSpace]:
    if not plans:
        raise ValueError("a crowd needs at least one floor")
    for door in parameters.doors:
        if door.floor not in plans:
            raise ValueError(f"doors: {door.id}: there is no floor {door.floor!r}; the site has: {', '.join(plans)}")
    return [
        FloorSpace(name, plan, [door for door in parameters.doors if door.floor == name], not parameters.doors)
        for name, plan in plans.items()
    ]
