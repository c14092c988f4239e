"""What one emulated phone measures: inertial samples and radio scans, on a clock of its own, block after block."""

from __future__ import annotations

import bisect
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.simulator.carrying import Carrying
from services.simulator.fleet import FleetParameters, Flushes, Kind
from services.simulator.gait import PhoneSensors
from services.simulator.magnetic import MagneticField
from services.simulator.people import Movement, People
from services.simulator.phone_batch import Inertial, PhoneBatch, PhoneClock, PhoneScan
from services.simulator.radio_world import RadioWorld
from services.simulator.scan_schedule import AdvertScans, ScanTimes, reports
from services.simulator.seeds import generator
from shared.site import Site

__all__ = ["EmulatedPhone", "FleetParameters", "PhoneBatch", "PhoneClock"]

Array = NDArray[np.float64]

_SPACING = 0.05  # seconds between the moments at which people are asked where they are
_SPACING_WITHOUT_SENSORS = 0.5
_BETWEEN_FLUSHED = 0.05  # seconds from one batch of a flush to the next


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
        self._ears = _Ears(site, radio, person, fleet, seed)
        self._mail = _Mail(person, fleet, self.clock, generator(seed, "phone network", person))
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


class _Ears:
    """When does a phone listen, and what does it hear?"""

    def __init__(self, site: Site, radio: RadioWorld, person: str, fleet: FleetParameters, seed: int) -> None:
        self._radio = radio.phone(person)
        self._listening: dict[Kind, ScanTimes] = {
            kind: ScanTimes(schedule, generator(seed, "phone scans", kind, person))
            for kind, schedule in fleet.schedules.items()
        }
        points = {point.id: point for point in site.access_points}
        self._columns: dict[Kind, list[tuple[int, str]]] = {
            kind: [
                (column, points[name].addresses[0].upper())
                for column, name in enumerate(radio.access_points)
                if points[name].kind == kind and points[name].addresses
            ]
            for kind in self._listening
        }
        self._adverts: dict[Kind, tuple[Array, Array]] = {}

    def hear(
        self, floors: Sequence[str], asked: Array, walk: Movement, start: float, end: float
    ) -> Iterator[PhoneScan]:
        """Yield the scans that end in [start, end), in order of time."""
        kinds = list(self._listening)
        times = [self._listening[kind].times(start, end) for kind in kinds]
        when = np.concatenate([*times, np.empty(0)])
        which = np.repeat(np.arange(len(kinds)), [len(part) for part in times])
        nearest = np.abs(asked[:, None] - when).argmin(axis=0) if len(when) else np.empty(0, np.int64)
        heard = walk.known[nearest, 0]
        order = np.argsort(when[heard], kind="stable")
        when, which, nearest = when[heard][order], which[heard][order], nearest[heard][order]
        scans: list[PhoneScan] = []
        readings = np.empty((0, 0))
        if len(when):
            readings = self._radio.scan(
                when,
                self._places(asked, walk, when, nearest),
                [floors[number] for number in walk.floor[nearest, 0]],
                walk.heading[nearest, 0],
            )
        for number, kind in enumerate(kinds):
            mine = which == number
            columns = [column for column, _ in self._columns[kind]]
            if not columns:
                continue
            rows = readings[mine][:, columns] if len(when) else np.empty((0, len(columns)))
            scans += self._reports(kind, when[mine], rows, end)
        scans.sort(key=lambda scan: scan.t)
        yield from scans

    @staticmethod
    def _places(asked: Array, walk: Movement, when: Array, nearest: NDArray[np.int64]) -> Array:
        """Return where the carrier was, (n, 2): between two moments where both are known, else at the nearest."""
        between = np.column_stack([np.interp(when, asked, walk.position[:, 0, axis]) for axis in (0, 1)])
        return np.where(np.isfinite(between), between, walk.position[nearest, 0])

    def _scans(self, kind: Kind, when: Array, readings: Array) -> Iterator[PhoneScan]:
        addresses = [address for _, address in self._columns[kind]]
        there = np.isfinite(readings)
        for t, row, heard in zip(when.tolist(), readings, there, strict=True):
            found = np.flatnonzero(heard)
            yield PhoneScan(t, kind, tuple(addresses[i] for i in found.tolist()), tuple(row[found].tolist()))

    def _reports(self, kind: Kind, when: Array, readings: Array, end: float) -> Iterator[PhoneScan]:
        """Yield a scan for every window of adverts that is over at ``end``; the others wait."""
        schedule = self._listening[kind].schedule
        if not isinstance(schedule, AdvertScans):
            yield from self._scans(kind, when, readings)
            return
        if kind in self._adverts:
            when = np.concatenate([self._adverts[kind][0], when])
            readings = np.concatenate([self._adverts[kind][1], readings])
        over = int(np.searchsorted(when, math.floor(end / schedule.window + 1e-9) * schedule.window))
        self._adverts[kind] = when[over:], readings[over:]
        if over:
            yield from self._scans(kind, *reports(schedule, when[:over], readings[:over]))


@dataclass(slots=True)
class _Times:
    """When the next flush is, how much of it is sent, and when the last batch arrived."""

    flush: float = math.inf
    flushed: int = 0
    arrived: float = -math.inf


class _Mail:
    """What waits to be put into batches, and how these reach the gateway."""

    def __init__(self, person: str, fleet: FleetParameters, clock: PhoneClock, rng: np.random.Generator) -> None:
        self.samples: list[tuple[Array, Array]] = []
        self.steps: list[tuple[Array, Array]] = []
        self.scans: list[PhoneScan] = []
        self._person = person
        self._fleet = fleet
        self._clock = clock
        self._rng = rng
        self._seq = 0
        self._told = 0
        self._times: _Times | None = None

    def post(self, end: float) -> Iterator[PhoneBatch]:
        """Yield a batch for every stretch of ``batch_seconds`` that is over at ``end`` and has something in it."""
        seconds = self._fleet.batch_seconds
        last = math.floor(end / seconds + 1e-9)
        if not (self.samples or self.scans):
            return
        t, values = _joined(self.samples, 9)
        step_t, step_length = _joined(self.steps, 0)
        scan_t = [scan.t for scan in self.scans]
        begin = min([*t[:1].tolist(), *scan_t[:1]])
        bounds = np.arange(max(math.floor(begin / seconds + 1e-9), self._told) + 1, last + 1) * seconds
        self._told = max(self._told, last)
        samples, steps = np.searchsorted(t, bounds), np.searchsorted(step_t, bounds)
        heard = [bisect.bisect_left(scan_t, bound) for bound in bounds.tolist()]
        i = j = k = 0
        for bound, i_next, j_next, k_next in zip(bounds.tolist(), samples.tolist(), steps.tolist(), heard, strict=True):
            if i_next - i >= 2 or k_next > k:
                inertial = Inertial(t[i:i_next], values[i:i_next]) if i_next - i >= 2 else None
                sent, arrival = self._journey(bound)
                yield PhoneBatch(
                    person=self._person,
                    seq=self._seq,
                    measured_until=bound,
                    sent=sent,
                    arrival=arrival,
                    clock=self._clock,
                    inertial=inertial,
                    scans=tuple(self.scans[k:k_next]),
                    step_t=step_t[j:j_next],
                    step_length=step_length[j:j_next],
                )
                self._seq += 1
            i, j, k = i_next, j_next, k_next
        self.samples = [(t[i:], values[i:])] if i < len(t) else []
        self.steps = [(step_t[j:], step_length[j:])] if j < len(step_t) else []
        self.scans = self.scans[k:]

    def _journey(self, measured: float) -> tuple[float, float]:
        """Return when a batch that is complete at ``measured`` is sent and when it arrives; never before another."""
        rng = self._rng
        if self._times is None:
            self._times = _Times()
            if isinstance(self._fleet.upload, Flushes):
                self._times.flush = measured + self._fleet.upload.every * float(rng.uniform(0.05, 0.98))
        times = self._times
        low, high = (max(bound, 1e-3) for bound in self._fleet.network_delay)
        delay = math.exp(rng.uniform(math.log(low), math.log(high)))
        if isinstance(self._fleet.upload, Flushes):
            while times.flush < measured:
                # A gateway takes nothing older than an hour: flushes come a little sooner than that.
                times.flush += self._fleet.upload.every * float(rng.uniform(0.9, 0.98))
                times.flushed = 0
            sent = times.flush + _BETWEEN_FLUSHED * times.flushed
            times.flushed += 1
        else:
            sent = measured + float(rng.uniform(0.005, 0.03))
        # One request after the other.
        sent = max(sent, times.arrived)
        times.arrived = max(sent + delay, times.arrived + 1e-3)
        return sent, times.arrived


def _joined(parts: list[tuple[Array, Array]], width: int) -> tuple[Array, Array]:
    if not parts:
        return np.empty(0), np.empty((0, width) if width else 0)
    if len(parts) == 1:
        return parts[0]
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def _runs(known: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and last place of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]])))
    return [(int(first), int(after) - 1) for first, after in edges.reshape(-1, 2)]
