"""What one emulated phone measures: inertial samples and radio scans, on a clock of its own, second by second."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from services.simulator.gait import PhoneSensors
from services.simulator.people import Motion, People
from services.simulator.radio_world import PhoneRadio, RadioWorld
from services.simulator.seeds import generator
from shared.site import Site

__all__ = ["RATE", "EmulatedPhone", "PhoneClock"]

Array = NDArray[np.float64]

RATE = 50.0
"""Inertial samples a second."""


@dataclass(frozen=True, slots=True)
class PhoneClock:
    """A phone's own clock: ahead by ``offset`` seconds, and running fast by ``drift`` (seconds per second)."""

    offset: float
    drift: float
    since: float
    """The true time from which the drift counts."""

    @classmethod
    def draw(cls, rng: np.random.Generator, since: float) -> PhoneClock:
        """Return a clock that is wrong by a second to a day, fast or slow, and drifts by some 20 ppm."""
        size = math.exp(rng.uniform(0.0, math.log(86_400.0)))
        return cls(float(rng.choice([-1.0, 1.0]) * size), float(rng.normal(0.0, 20e-6)), since)

    def read(self, true_time: Array) -> Array:
        """Return what the phone's clock shows at true times (n,), seconds since the epoch."""
        return true_time + self.offset + self.drift * (true_time - self.since)


class EmulatedPhone:
    """The phone of one person. Measurements are drawn in order: the same seed and motion, the same readings.

    Args:
        site: for its access points' addresses and its north.
        world: the radio it hears.
        person: who carries it.
        floor: where that person is.
        seed: of sensors, clock and scan schedule.
        carrying: in the hand or in a pocket.
        scan_interval: seconds between two radio scans.
        started: true time at which its clock begins to drift.
    """

    def __init__(
        self,
        site: Site,
        world: RadioWorld,
        person: str,
        floor: str,
        seed: int,
        carrying: Literal["hand", "pocket"] = "hand",
        scan_interval: float = 1.0,
        started: float = 0.0,
    ) -> None:
        self.person = person
        self.carrying = carrying
        rng = generator(seed, "phone", person)
        self.clock = PhoneClock.draw(rng, started)
        self._sensors = PhoneSensors(generator(seed, "phone sensors", person), site.north_radians, carrying, RATE)
        self._radio: PhoneRadio = world.phone(person)
        self._floor = floor
        self._interval = scan_interval
        self._scan_phase = float(rng.uniform(0.0, scan_interval))
        # Phones report the addresses they hear, each kind of radio in a scan of its own.
        self._heard_as = [
            (column, point.kind, point.addresses[0].upper())
            for column, point in enumerate(site.access_points)
            if point.addresses
        ]

    def measure(self, people: People, start: float, end: float, epoch: float) -> dict[str, Any] | None:
        """Return what was measured in world time [start, end) as a batch without ``sent`` and ``seq``.

        Args:
            people: where its carrier is.
            start: seconds, world time; a whole number of samples.
            end: seconds, world time.
            epoch: true time of world time zero.

        Returns:
            ``imu`` and ``radio`` as the gateway takes them, times on the phone's clock; None if it was not about.
        """
        times = np.arange(math.ceil(start * RATE - 1e-6), math.ceil(end * RATE - 1e-6)) / RATE
        if not len(times):
            return None
        motion = people.motion(self.person, times)
        known = motion.known
        if known.sum() < 2:  # one sample is no movement
            return None
        times = times[known]
        motion = Motion(motion.position[known], motion.heading[known], motion.speed[known], motion.present[known])
        samples = self._sensors.sample(motion.heading, motion.speed)
        imu: dict[str, list[float]] = {"t": np.round(self.clock.read(epoch + times), 4).tolist()}
        for letter, columns in (("a", samples.acceleration), ("g", samples.rotation), ("m", samples.field)):
            for axis, name in enumerate("xyz"):
                imu[letter + name] = np.round(columns[:, axis], 4).tolist()
        return {"imu": imu, "radio": self._scans(times, motion, epoch)}

    def _scans(self, times: Array, motion: Motion, epoch: float) -> list[dict[str, Any]]:
        first = math.ceil((times[0] - self._scan_phase) / self._interval - 1e-9)
        when = np.arange(first, first + math.ceil((times[-1] - times[0]) / self._interval) + 2) * self._interval
        when = when + self._scan_phase
        when = when[(when >= times[0] - 1e-9) & (when < times[-1] + 1.0 / RATE - 1e-9)]
        if not len(when):
            return []
        places = motion.position[np.searchsorted(times, when).clip(0, len(times) - 1)]
        readings = self._radio.scan(places, self._floor)
        scans = []
        for t, row in zip(self.clock.read(epoch + when).tolist(), readings.tolist(), strict=True):
            for kind in dict.fromkeys(kind for _, kind, _ in self._heard_as):
                heard = [(a, row[c]) for c, k, a in self._heard_as if k == kind and math.isfinite(row[c])]
                scans.append(
                    {
                        "t": round(t, 4),
                        "kind": kind,
                        "address": [address for address, _ in heard],
                        "rssi": [rssi for _, rssi in heard],
                    }
                )
        return scans
