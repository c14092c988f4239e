"""What does everybody in a crowd do next? People decide, step by step, where to go, how long to stay and when to leave.

What they want comes from ``agenda``, how they get there from ``walking``, who keeps whom company from ``companions``,
who comes and goes from ``admission``. Steps are fixed and every part draws from a generator of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from services.simulator.crowd.admission import Admission
from services.simulator.crowd.agenda import Agenda, Goal, Mind, cruising_speed
from services.simulator.crowd.companions import Companions
from services.simulator.crowd.floor_space import DoorPlace, spaces_of
from services.simulator.crowd.walker_parameters import WalkerParameters
from services.simulator.crowd.walking import AWAY, BETWEEN, STANDING, STEP, WALKING, Walking
from services.simulator.seeds import generator
from shared.site import FloorPlan

__all__ = ["CrowdSteps"]

Array = NDArray[np.float64]

_BEFORE = 200  # steps walked before the world begins: its first moment is one of many
_CALLS = 5  # steps between two looks at how many people there are
_PATIENCE = 20.0  # seconds that somebody waits for room at a door
_STAYS = 0.8  # chance that a passer with a phone turns round at the door


class CrowdSteps:
    """Everybody's minds and bodies at the latest step.

    Args:
        plans: the floors by id.
        parameters: who they are and what they do.
        seed: of everything.

    Attributes:
        persons: their ids.
        floors: ids of the floors.
        spaces: the floors for walkers, in that order.
        walking: where everybody is and what they are at.
        companions: who keeps whom company.
        number: of the latest step; negative before the world begins.

    Raises:
        ValueError: nobody could walk or come in here, or a door is where none can be.
    """

    def __init__(self, plans: Mapping[str, FloorPlan], parameters: WalkerParameters, seed: int) -> None:
        self._parameters = parameters
        self._passers = parameters.behaviour == "passers"
        spaces = spaces_of(plans, parameters)
        self.floors, self.spaces = tuple(spaces), list(spaces.values())
        self._agendas = [Agenda(parameters, space) for space in self.spaces]
        self._doors = {door.door.id: (number, door) for number, s in enumerate(self.spaces) for door in s.doors}
        self.persons = tuple(f"person-{number}" for number in range(1, parameters.pool + 1))
        self._minds = [Mind(generator(seed, "walker", person)) for person in self.persons]
        rngs = [mind.rng for mind in self._minds]
        self._cruise = np.array([cruising_speed(rng, parameters.speed) for rng in rngs])
        self.walking = Walking(spaces, rngs, self._cruise, parameters, seed)
        self.companions = Companions()
        self._admission = Admission(parameters, seed)
        count = len(self.persons)
        self.number = -_BEFORE
        self._wake = np.full(count, math.inf)
        self._shuffle = np.full(count, math.inf)
        self._turn = np.full(count, math.inf)
        self._waiting: dict[int, Goal] = {}  # companions who set off in a moment
        self._arrival: dict[int, tuple[DoorPlace, int, float]] = {}  # between floors: door, floor, half-way time
        self._gone = np.zeros(count, bool)  # past the door, still seen for a step or two
        self._queue: list[tuple[int, int, DoorPlace, float]] = []  # outside: person, floor, door, since when
        self._populate()

    @property
    def _now(self) -> float:
        return self.number * STEP

    def step(self) -> None:
        """Let everybody decide, and walk for ``STEP`` seconds."""
        walking = self.walking
        for person in walking.hindered():
            self._give_up(person)
        for person in np.flatnonzero(walking.doing == WALKING).tolist():
            goal = walking.goal[person]
            if goal is not None and goal.door is not None and not self._passes(person, goal.door):
                self._think_again(person)
        for person in walking.arrivals():
            self._arrive(person)
        for person in np.flatnonzero(self._wake <= self._now).tolist():
            self._wake_up(person)
        self._fidget()
        if self.number % _CALLS == 0:
            self._come_and_go()
        walking.advance(self.companions.groups())
        self.number += 1

    def state(self) -> tuple[Array, NDArray[np.int16], NDArray[np.bool_]]:
        """Return x, y, heading, speed, walked (p, 5), floor (p,) and who is there (p,), after the latest step."""
        bodies, floor = self.walking.bodies, self.walking.floor.copy()
        for person, (door, there, half) in self._arrival.items():
            if self._now >= half:
                floor[person] = there
                bodies.position[person] = door.middle
        rows = np.column_stack([bodies.position, bodies.heading, bodies.speed, bodies.walked])
        return rows, floor, self.walking.present

    # What one person does

    def _wake_up(self, person: int) -> None:
        """Begin what comes next."""
        self._wake[person] = math.inf
        doing = self.walking.doing[person]
        if self.walking.shuffles(person):
            self._wake[person] = self._now + 0.3
        elif doing == BETWEEN:
            door, floor, _ = self._arrival[person]
            if self._enter(person, floor, door):
                del self._arrival[person]
                self._agendas[floor].settle(self._minds[person])
                self._decide(person)
            else:
                self._wake[person] = self._now + 0.5
        elif doing == STANDING and person in self._waiting:
            self._set_off(person, self._waiting.pop(person))
        elif doing == STANDING:
            self._decide(person)

    def _decide(self, person: int) -> None:
        """Choose where to go; whoever leads takes the companions along."""
        if not self._leads(person):
            return
        mind, agenda, walking = self._minds[person], self._agenda(person), self.walking
        leaves = not self._passers and self._now >= mind.due
        if leaves and not self._may_go(person):
            mind.due, leaves = self._now + mind.rng.uniform(20.0, 60.0), False
        here = walking.here[person]
        goal = agenda.way_out(mind, here) if leaves else agenda.next_goal(mind, here, walking.taken(person))
        self._set_off(person, goal)
        for other in self.companions.of(person):
            if other == person or walking.floor[other] != walking.floor[person] or walking.doing[other] == BETWEEN:
                continue
            beside = agenda.beside(goal, self._minds[other].rng, walking.taken(other))
            self._minds[other].due = max(self._minds[other].due, mind.due)
            if walking.doing[other] == WALKING:
                self._set_off(other, beside)
            else:
                walking.place[other] = beside.place
                self._waiting[other] = beside
                self._wake[other] = self._now + self._minds[other].rng.uniform(0.0, 1.2)

    def _leads(self, person: int) -> bool:
        """Whether this person decides alone or for a group; who does not follows, and groups may part here."""
        walking, leader = self.walking, self.companions.leader(person)
        if leader is None:
            return True
        if leader == person:
            if self._minds[person].rng.random() < self._parameters.split:
                for other in self.companions.of(person):
                    if other != person:
                        self._part(other)
            return True
        goal = walking.goal[leader]
        if walking.floor[leader] == walking.floor[person] and goal is not None:
            rng, taken = self._minds[person].rng, walking.taken(person)
            self._set_off(person, self._agenda(person).beside(goal, rng, taken))
            return False
        if walking.doing[leader] == BETWEEN or any(leader == one for one, *_ in self._queue):
            self.companions.lead(person)  # until the others are here
        else:
            self._part(person)
        return True

    def _agenda(self, person: int) -> Agenda:
        return self._agendas[int(self.walking.floor[person])]

    def _set_off(self, person: int, goal: Goal) -> None:
        self._wake[person] = self._shuffle[person] = self._turn[person] = math.inf
        self._waiting.pop(person, None)
        self.walking.set_off(person, goal)

    def _arrive(self, person: int) -> None:
        """Stay at the goal, go out by the door, or go on standing after a step or two."""
        goal = self.walking.goal[person]
        if self.walking.shuffles(person):
            self.walking.stand(person)
        elif goal is not None and goal.door is not None:
            self._go_out(person, goal.door)
        else:
            self._stay(person, math.inf if goal is None else goal.dwell)

    def _stay(self, person: int, dwell: float) -> None:
        """Stand for ``dwell`` seconds; for ever means until the leader goes."""
        rng, t = self._minds[person].rng, self._now
        self.walking.stand(person)
        if math.isinf(dwell) and self.companions.leader(person) in (None, person):
            dwell = self._agenda(person).dwell(rng)
        self._wake[person] = t + dwell
        self.walking.face_goal(person)
        self._shuffle[person] = t + 3.0 + rng.exponential(12.0)
        self._turn[person] = t + 2.0 + rng.exponential(8.0)

    def _fidget(self) -> None:
        """Standing people turn on the spot and take a step or two."""
        walking, t = self.walking, self._now
        standing = walking.doing == STANDING
        for person in np.flatnonzero(standing & (self._turn <= t)).tolist():
            towards, seconds = self._agenda(person).turn(self._minds[person], walking.goal[person])
            if towards is None:
                walking.face_goal(person)
            else:
                walking.facing[person] = towards
            self._turn[person] = t + seconds
        for person in np.flatnonzero(standing & (self._shuffle <= t)).tolist():
            here, home = walking.here[person], walking.place[person]
            place, seconds = self._agenda(person).shuffle(self._minds[person], here, home)
            self._shuffle[person] = t + seconds
            walking.shift(person, place)

    def _give_up(self, person: int) -> None:
        """Be content with here, or choose another goal."""
        walking, goal = self.walking, self.walking.goal[person]
        if walking.shuffles(person):
            walking.stand(person)
        elif goal is not None and goal.door is not None and self._gone[person] and not walking.present[person]:
            self._go_out(person, goal.door)
        elif goal is None or goal.door is not None or not walking.present[person]:
            self._think_again(person)
        else:
            walking.place[person] = walking.here[person]
            self._stay(person, min(goal.dwell, 5.0) if math.isfinite(goal.dwell) else math.inf)

    def _think_again(self, person: int) -> None:
        """Choose another goal, alone, and stay for a while before leaving is thought of again."""
        mind = self._minds[person]
        self._part(person)
        self._gone[person] = False
        mind.due = max(mind.due, self._now + mind.rng.uniform(60.0, 180.0))
        here, taken = self.walking.here[person], self.walking.taken(person)
        self._set_off(person, self._agenda(person).next_goal(mind, here, taken))

    def _part(self, person: int) -> None:
        """Go one's own way from now on."""
        self.walking.pace.cruise[person] = self._cruise[person]
        for other in [person, *self.companions.leave(person)]:
            stands = self.walking.doing[other] == STANDING or self.walking.shuffles(other)
            if stands and math.isinf(self._wake[other]):
                self._wake[other] = self._now + self._minds[other].rng.uniform(0.5, 6.0)

    # Coming and going

    def _may_go(self, person: int) -> bool:
        """Whether enough people stay if this one goes."""
        present = self.walking.present
        return not present[person] or int((present & ~self._gone).sum()) > self._parameters.present[0]

    def _passes(self, person: int, door: DoorPlace) -> bool:
        """Whether a person on the way to a door may go on; refused at the door, where too few would stay."""
        walking = self.walking
        if not door.outside or self._gone[person] or not walking.present[person]:
            return True
        if float((walking.here[person] - door.middle) @ door.inward) > 0.6:
            return True
        carries = person < self._parameters.carriers
        if self._passers and carries and self._minds[person].rng.random() < _STAYS:
            return False
        self._gone[person] = self._may_go(person)
        return bool(self._gone[person])

    def _go_out(self, person: int, door: DoorPlace) -> None:
        """Leave the floor for outside or for another one."""
        walking = self.walking
        if not self._gone[person] and not self._may_go(person):
            self._think_again(person)
            return
        floor = walking.floor[person]
        walking.remove(person)
        self._wake[person] = self._shuffle[person] = self._turn[person] = math.inf
        self._gone[person] = False
        self._waiting.pop(person, None)
        if door.door.leads_to is None:
            self._part(person)
            self._admission.left(person, self._now)
            return
        there, other_door = self._doors[door.door.leads_to]
        seconds = max(door.door.seconds * self._minds[person].rng.uniform(0.8, 1.2), 2.0 * STEP)
        walking.doing[person], walking.floor[person] = BETWEEN, floor
        self._arrival[person] = (other_door, there, self._now + 0.5 * seconds)
        self._wake[person] = self._now + seconds

    def _enter(self, person: int, floor: int, door: DoorPlace) -> bool:
        """Let a person appear at a door if there is room; they have no goal yet."""
        rng, space = self._minds[person].rng, self.spaces[floor]
        spot = space.nearest_clear(door.spot(rng, rng.uniform(2.0, 2.9)))
        heading = math.atan2(door.inward[1], door.inward[0]) if door.outside else rng.uniform(-math.pi, math.pi)
        return self.walking.put(person, floor, spot, heading)

    def _come_and_go(self) -> None:
        """Let in who waits, call who is missing, ask to go who is too many."""
        walking, t = self.walking, self._now
        for entry in list(self._queue):
            person, floor, door, since = entry
            if self._enter(person, floor, door):
                self._queue.remove(entry)
                self._agendas[floor].arrive(self._minds[person], t, door.door.id)
                self._decide(person)
            elif t - since > _PATIENCE:
                self._queue.remove(entry)
                self._part(person)
        there = walking.doing != AWAY
        dues = np.array([mind.due for mind in self._minds])
        leaving = self._gone | ((dues <= t) & (not self._passers))
        staying = int((there & ~leaving).sum()) + len(self._queue)
        wanted = self._admission.wanted(_CALLS * STEP)
        away = ~there
        away[[one for one, *_ in self._queue]] = False
        outside = int((there & ~walking.present & ~self._gone).sum()) + len(self._queue)
        most = self._parameters.present[1] - int(walking.present.sum()) - outside
        called = self._admission.next(t, away, wanted - staying, most)
        if called:
            self._call(called)
        elif staying > wanted and not self._passers:
            candidates = np.flatnonzero(there & ~leaving & walking.present)
            candidates = candidates[candidates >= self._parameters.carriers]
            if len(candidates):
                person = int(candidates[dues[candidates].argmin()])
                self._minds[person].due = t
                self._wake[person] = min(self._wake[person], t + self._admission.rng.uniform(0.0, 15.0))

    def _call(self, persons: Sequence[int]) -> None:
        """Let people come in together by one door."""
        doors = [(floor, door) for floor, space in enumerate(self.spaces) for door in space.doors]
        doors = [(floor, door) for floor, door in doors if door.door.leads_to is None] or doors
        widths = np.array([door.door.width for _, door in doors])
        floor, door = doors[int(self._admission.rng.choice(len(doors), p=widths / widths.sum()))]
        self._queue += [(person, floor, door, self._now) for person in persons]
        self._together(persons)

    def _together(self, persons: Sequence[int]) -> None:
        self.companions.form(persons)
        if len(persons) > 1:
            self.walking.pace.cruise[list(persons)] = self._cruise[list(persons)].mean()

    def _populate(self) -> None:
        """Begin in the middle of things: people stand and walk about, alone and in groups."""
        rng = self._admission.rng
        persons = self._admission.first(self._admission.wanted(0.0))
        areas = np.array([space.inside.area if space.doors else 0.0 for space in self.spaces])
        while persons:
            size = min(self._admission.group_size(), len(persons))
            members, persons = persons[:size], persons[size:]
            floor = int(rng.choice(len(areas), p=areas / areas.sum()))
            placed: list[int] = []
            for person in members:
                near = self.walking.here[placed[0]] if placed else None
                if self._begin(person, floor, near):
                    placed.append(person)
            self._together(placed)
        found, low = int(self.walking.present.sum()), self._parameters.present[0]
        if found < low:
            raise ValueError(f"present: there is room for {found} people on these floors, {low} are wanted")

    def _begin(self, person: int, floor: int, near: Array | None) -> bool:
        """Let somebody be inside from the first moment, if there is room; companions ``near`` each other."""
        mind, space = self._minds[person], self.spaces[floor]
        for attempt in range(80):
            if near is not None and attempt < 30:
                spot = near + mind.rng.uniform(-1.5, 1.5, 2)
                if not (space.is_clear(spot) and space.plan.contains(spot[None])[0]):
                    continue
            else:
                spot = space.random_place(mind.rng)
            if self.walking.put(person, floor, spot, mind.rng.uniform(-math.pi, math.pi)):
                self._agendas[floor].arrive(mind, self._now, "")
                mind.due = self._now + mind.rng.uniform(0.0, self._parameters.visit[1])
                self._wake[person] = self._now + mind.rng.uniform(0.0, 15.0)
                self.walking.present[person] = True
                return True
        return False
