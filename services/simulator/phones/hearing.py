"""When does a phone listen, and what does it hear? Scans of Wi-Fi and windows of Bluetooth adverts, with addresses."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from services.simulator.people import Movement
from services.simulator.phones.fleet import FleetParameters, Kind
from services.simulator.phones.phone_batch import PhoneScan
from services.simulator.radio.radio_world import RadioWorld
from services.simulator.radio.scan_schedule import AdvertScans, ScanTimes, reports
from services.simulator.seeds import generator
from shared.site import Site

__all__ = ["Ears"]

Array = NDArray[np.float64]


class Ears:
    """The radio of one phone; asked block after block.

    Args:
        site: for the addresses of its access points; those without one are heard by nobody.
        radio: what there is to hear.
        person: who carries the phone.
        fleet: when it listens for what.
        seed: of the schedule's phase and jitter.
    """

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
        """Yield the scans that end in [start, end), in order of time; windows that began before it are among them.

        Args:
            floors: ids of the floors that ``walk`` counts.
            asked: (m,) seconds from ``start`` to ``end`` at which the carrier's whereabouts are given.
            walk: the carrier's movement then, of one person.
            start, end: the block, world seconds.
        """
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
