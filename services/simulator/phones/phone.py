"""What one emulated phone measures: inertial samples and radio scans, on a clock of its own, block after block."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from services.simulator.people import Movement, People
from services.simulator.phones.carrying import Carrying
from services.simulator.phones.fleet import FleetParameters
from services.simulator.phones.gait import PhoneSensors
from services.simulator.phones.hearing import Ears
from services.simulator.phones.magnetic import MagneticField
from services.simulator.phones.mailing import Mail
from services.simulator.phones.phone_batch import PhoneBatch, PhoneClock
from services.simulator.radio.radio_world import RadioWorld
from services.simulator.seeds import generator
from shared.site import Site

__all__ = ["EmulatedPhone", "FleetParameters", "PhoneBatch", "PhoneClock"]

Array = NDArray[np.float64]

_SPACING = 0.05  # seconds between the moments at which people are asked where they are
_SPACING_WITHOUT_SENSORS = 0.5


class EmulatedPhone:
    """The phone of one person. Blocks are asked for in order: the same seed and blocks, the same measurements.

    Args:
        site: for the addresses of its access points.
        radio: what it hears.
        magnetic: what bends its compass.
        person: who carries it.
        fleet: what kind of phone it is.
        seed: of sensors, clock, habits and journeys through the network.
    """

    def __init__(
        self, site: Site, radio: RadioWorld, magnetic: MagneticField, person: str, fleet: FleetParameters, seed: int
    ) -> None:
        self.person = person
        self.fleet = fleet
        self.clock = PhoneClock.draw(generator(seed, "phone clock", person), fleet.clock_offset, fleet.clock_drift)
        self.carrying: Carrying = fleet.carrying
        self.sensors = PhoneSensors(
            generator(seed, "phone sensors", person),
            fleet.carrying,
            fleet.inertial_rate or 50.0,
            fleet.sensors,
            fleet.stride,
            fleet.habits,
        )
        self._magnetic = magnetic
        self._sampling = generator(seed, "phone sampling", person)
        self._ears = Ears(site, radio, person, fleet, seed)
        self._mail = Mail(person, fleet, self.clock, generator(seed, "phone network", person))
        self._place: int | None = None
        self._awake = False
        self._next_hole = self._hole_after(0.0)

    def block(self, people: People, start: float, end: float) -> list[PhoneBatch]:
        """Return the batches whose stretch of time ends in (start, end], in order of ``seq``.

        Blocks follow each other without a gap. Batches that are sent late (``Flushes``) are returned when they are
        measured; ``arrival`` says when the gateway has them. While the carrier is away, nothing is measured.

        Args:
            people: where its carrier is.
            start: seconds, world time.
            end: seconds, world time.
        """
        if self._place is None:
            self._place = list(people.persons).index(self.person)
        spacing = _SPACING if self.fleet.inertial_rate else _SPACING_WITHOUT_SENSORS
        asked = np.linspace(start, end, max(1, math.ceil((end - start) / spacing - 1e-9)) + 1)
        walk = people.movement(asked, [self._place])
        known = walk.known[:, 0]
        if known.any():
            if self.fleet.inertial_rate:
                for first, last in _runs(known):
                    if first > 0 or not self._awake:
                        self.sensors.restart()
                    self._sense(people.floors, asked, walk, first, last)
            for scan in self._ears.hear(people.floors, asked, walk, start, end):
                self._mail.scans.append(scan)
        self._awake = bool(known[-1])
        return list(self._mail.post(end))

    def _sense(self, floors: Sequence[str], asked: Array, walk: Movement, first: int, last: int) -> None:
        """Measure from ``asked[first]`` to ``asked[last]``, between which the carrier is known."""
        rate, fleet = self.fleet.inertial_rate, self.fleet
        t = np.arange(math.ceil(asked[first] * rate - 1e-6), math.ceil(asked[last] * rate - 1e-6)) / rate
        if len(t) < 2:  # one sample is no movement
            return
        # A sample is late by a part of a millisecond, as an operating system delivers it.
        t = t + self._sampling.uniform(0.0, min(fleet.sample_jitter, 0.9 / rate), len(t))
        between = slice(first, last + 1)
        moments = asked[between]
        heading, speed, walked = (
            np.interp(t, moments, column[between, 0]) for column in (walk.heading, walk.speed, walk.walked)
        )
        field = self._field(floors, walk, between)
        bent = np.column_stack([np.interp(t, moments, field[:, axis]) for axis in range(3)])
        samples = self.sensors.sample(t, heading, speed, walked, bent)
        values = np.concatenate([samples.acceleration, samples.rotation, samples.field], axis=1)
        kept = np.ones(len(t), bool)
        while self._next_hole < t[-1]:
            hole = self._next_hole + float(self._sampling.uniform(0.02, 0.1))
            kept &= (t < self._next_hole) | (t > hole)
            self._next_hole = self._hole_after(hole)
        self._mail.samples.append((t[kept], values[kept]))
        self._mail.steps.append((samples.steps.t, samples.steps.length))

    def _field(self, floors: Sequence[str], walk: Movement, between: slice) -> Array:
        position, floor = walk.position[between, 0], walk.floor[between, 0]
        if (floor == floor[0]).all():
            return self._magnetic.at(position, floors[floor[0]])
        field = np.empty((len(floor), 3))
        for number in np.unique(floor):
            field[floor == number] = self._magnetic.at(position[floor == number], floors[number])
        return field

    def _hole_after(self, t: float) -> float:
        mean = self.fleet.hole_every
        return t + float(self._sampling.exponential(mean)) if mean > 0 else math.inf


def _runs(known: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and last place of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]])))
    return [(int(first), int(after) - 1) for first, after in edges.reshape(-1, 2)]
