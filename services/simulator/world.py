"""One world, made block after block: who walks where, what every camera sees and every phone measures.

Scenario, site and seed decide everything. Off-line the blocks are made as fast as they can be, live they are made
ahead of the clock; the world is the same. Times are seconds since the world began.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from services.simulator.cameras.detection_files import FileDetections
from services.simulator.cameras.detections import DetectionModel
from services.simulator.crowd.crowd import Crowd
from services.simulator.crowd.trajectories import Trajectories
from services.simulator.faults import CameraFaults, PhoneFaults
from services.simulator.people import BLOCK, Movement, People
from services.simulator.phones.fleet import FleetParameters
from services.simulator.phones.magnetic import MagneticField
from services.simulator.phones.phone import EmulatedPhone
from services.simulator.phones.phone_batch import PhoneBatch
from services.simulator.radio.radio_world import RadioWorld
from services.simulator.scenario_file import DetectedView, FileView, RecordedPeople, RenderedView, Scenario
from shared.messages import DetectionFrame
from shared.site import Camera, Site
from shared.truth import GroundTruth

__all__ = [
    "Arrival",
    "Carrier",
    "World",
    "WorldBlock",
    "cameras_of",
    "cameras_without_pictures",
    "carriers_of",
    "people_of",
    "truth_messages",
]

Array = NDArray[np.float64]


class _Eye(Protocol):
    """What a camera without pictures is."""

    def frames(self, people: People, start: float, end: float) -> list[DetectionFrame]: ...


@dataclass(frozen=True, slots=True)
class Carrier:
    """Somebody with a phone."""

    person: str
    device: str
    fleet: FleetParameters


@dataclass(frozen=True, slots=True)
class WorldBlock:
    """Five seconds of world.

    Attributes:
        start, end: seconds.
        frames: arrival time and what a camera said, in order of arrival; late ones may arrive after ``end``.
        batches: what phones measured, in order of arrival; some arrive long after ``end``.
        truth_t: (n,), the times at which the truth is told.
        truth: where everybody is then.
    """

    start: float
    end: float
    frames: Sequence[tuple[float, DetectionFrame]]
    batches: Sequence[PhoneBatch]
    truth_t: Array
    truth: Movement


M = TypeVar("M", covariant=True)


@dataclass(frozen=True, slots=True)
class Arrival(Generic[M]):
    """Something that arrives at world time ``t``."""

    t: float
    message: M


class World:
    """The world of one scenario and seed.

    Args:
        scenario: what happens; checked by ``scenario_loading``.
        site: where.
        seed: of everything random; None: the scenario's test seed.
        people: seed of all that another day brings: other people with other phones, other mistakes of cameras, another
            course of what drifts. The place, its radio and its magnetic field stay those of ``seed``. None: ``seed``.
    """

    def __init__(self, scenario: Scenario, site: Site, seed: int | None = None, people: int | None = None) -> None:
        self.scenario = scenario
        self.site = site
        self.seed = scenario.seeds.test if seed is None else seed
        day = self.seed if people is None else people
        self.people = people_of(scenario, site, day)
        self.carriers = carriers_of(scenario, self.people)
        self.radio = RadioWorld(site, self.seed, scenario.radio, day)
        magnetic = MagneticField(site, scenario.magnetic, self.seed)
        self.phones = [
            EmulatedPhone(site, self.radio, magnetic, carrier.person, carrier.fleet, day) for carrier in self.carriers
        ]
        self._eyes: Mapping[str, _Eye] = {
            camera.id: _eye(view, camera, site, day)
            for view in scenario.views
            if not isinstance(view, RenderedView)
            for camera in cameras_of(view.camera, site)
        }
        self._camera_faults = CameraFaults(scenario.faults, day)
        self._phone_faults = PhoneFaults(scenario.faults, day, [carrier.person for carrier in self.carriers])
        self._made = 0

    @property
    def devices(self) -> dict[str, str]:
        """Device ids by person."""
        return {carrier.person: carrier.device for carrier in self.carriers}

    @property
    def made(self) -> float:
        """Seconds of world that exist."""
        return self._made * BLOCK

    def holds_phone(self, person: str) -> bool:
        """Whether somebody's hand holds a phone, for who draws them."""
        return any(carrier.person == person and carrier.fleet.carrying != "pocket" for carrier in self.carriers)

    def next_block(self) -> WorldBlock:
        """Make the next five seconds."""
        start, end = self._made * BLOCK, (self._made + 1) * BLOCK
        frames = [
            entry
            for camera, eye in self._eyes.items()
            for entry in self._camera_faults.arrivals(camera, eye.frames(self.people, start, end))
        ]
        batches = [
            batch
            for phone in self.phones
            for batch in self._phone_faults.arrivals(phone.block(self.people, start, end))
        ]
        told = self.people.instants(start - 1e-6, end - 1e-6)
        self._made += 1
        return WorldBlock(
            start=start,
            end=end,
            frames=sorted(frames, key=lambda entry: (entry[0], entry[1].camera, entry[1].seq)),
            batches=sorted(batches, key=lambda batch: (batch.arrival, batch.person, batch.seq)),
            truth_t=told,
            truth=self.people.movement(told) if len(told) else self.people.movement(np.array([start])),
        )

    def arrivals(
        self, until: float, made: Callable[[WorldBlock], None] = lambda block: None
    ) -> Iterator[Arrival[DetectionFrame | PhoneBatch]]:
        """Make the world up to ``until`` seconds and yield all that arrives by then, in order of arrival.

        Args:
            until: seconds.
            made: called with each block when it has been made, for who keeps the truth.
        """
        waiting: list[tuple[float, int, DetectionFrame | PhoneBatch]] = []
        order = itertools.count()
        while self.made < until:
            block = self.next_block()
            made(block)
            for t, frame in block.frames:
                heapq.heappush(waiting, (t, next(order), frame))
            for batch in block.batches:
                heapq.heappush(waiting, (batch.arrival, next(order), batch))
            # What the next block makes cannot arrive before that block begins.
            while waiting and waiting[0][0] < min(block.end, until):
                t, _, message = heapq.heappop(waiting)
                yield Arrival(t, message)


def truth_messages(world: World, block: WorldBlock) -> list[GroundTruth]:
    """Return where everybody was in a block as messages, one per instant, times in world seconds."""
    floors, persons, devices = world.people.floors, world.people.persons, world.devices
    messages = []
    for row, t in enumerate(block.truth_t.tolist()):
        there = np.flatnonzero(block.truth.present[row]).tolist()
        places = block.truth.position[row, there]
        messages.append(
            GroundTruth(
                t=t,
                person=[persons[index] for index in there],
                floor=[floors[place] for place in block.truth.floor[row, there].tolist()],
                x=places[:, 0].tolist(),
                y=places[:, 1].tolist(),
                device=[devices.get(persons[index]) for index in there],
            )
        )
    return messages


def people_of(scenario: Scenario, site: Site, seed: int) -> People:
    """Return the people of a scenario.

    Raises:
        ValueError: nobody could walk on this plan, or the recorded file cannot be read; the text says why.
    """
    chosen = scenario.people
    if isinstance(chosen, RecordedPeople):
        read = {"csv": Trajectories.from_csv, "mot": Trajectories.from_mot, "eth": Trajectories.from_eth}
        return read[chosen.format](chosen.file, chosen.floor or site.floors[0].id)
    plans = {floor.id: floor.plan() for floor in site.floors}
    carriers = max(chosen.walkers.carriers, sum(fleet.count for fleet in scenario.phones))
    return Crowd(plans, chosen.walkers.model_copy(update={"carriers": carriers}), seed)


def carriers_of(scenario: Scenario, people: People) -> list[Carrier]:
    """Return who carries which phone: the crowd's first people, or those longest present in a recorded file."""
    count = sum(fleet.count for fleet in scenario.phones)
    persons = people.longest_present(count) if isinstance(people, Trajectories) else list(people.persons[:count])
    kinds = [(fleet, number + 1) for fleet in scenario.phones for number in range(fleet.count)]
    return [
        Carrier(person, f"{fleet.name}-{number}", fleet)
        for person, (fleet, number) in zip(persons, kinds, strict=False)
    ]


def cameras_of(wanted: str, site: Site) -> list[Camera]:
    """Return the cameras a view means: one, or with ``*`` all."""
    return list(site.cameras) if wanted == "*" else [site.camera(wanted)]


def cameras_without_pictures(scenario: Scenario, site: Site) -> set[str]:
    """Return the cameras of which the twin itself makes the detections."""
    views = [view for view in scenario.views if not isinstance(view, RenderedView)]
    return {camera.id for view in views for camera in cameras_of(view.camera, site)}


def _eye(view: DetectedView | FileView, camera: Camera, site: Site, seed: int) -> _Eye:
    floor = site.floor(site.area(camera.area).floor)
    if isinstance(view, FileView):
        return FileDetections(camera, floor.id, view.file, view.detections)
    return DetectionModel(camera, floor, view.detection, view.frames_per_s, seed)
