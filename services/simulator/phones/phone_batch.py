"""What does a phone send, when, and on whose clock? One batch, as it was measured."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["IMU_COLUMNS", "ClockJump", "Inertial", "PhoneBatch", "PhoneClock", "PhoneScan"]

Array = NDArray[np.float64]

IMU_COLUMNS = ("ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz")
"""Names of the columns of ``Inertial.values``, as the gateway calls them."""


@dataclass(frozen=True, slots=True)
class ClockJump:
    """From ``at`` on (world seconds) a clock is further ahead by ``offset`` seconds and runs faster by ``drift``."""

    at: float
    offset: float
    drift: float


@dataclass(frozen=True, slots=True)
class PhoneClock:
    """A phone's own clock: ahead by ``offset`` seconds at world second zero, running fast by ``drift`` (s/s)."""

    offset: float
    drift: float
    jumps: tuple[ClockJump, ...] = ()

    @classmethod
    def draw(cls, rng: np.random.Generator, offset: tuple[float, float], drift_ppm: float) -> PhoneClock:
        """Return a clock, fast or slow.

        Args:
            rng: draws it.
            offset: least and greatest amount by which it is wrong, seconds; evenly drawn on a logarithmic scale.
            drift_ppm: standard deviation of the drift, parts per million.
        """
        low, high = offset
        size = math.exp(rng.uniform(math.log(max(low, 1e-3)), math.log(max(high, 1e-3)))) if high > 0.0 else 0.0
        return cls(float(rng.choice([-1.0, 1.0]) * size), float(rng.normal(0.0, 1e-6 * drift_ppm)))

    def read(self, t: Array) -> Array:
        """Return what the clock shows at world times (n,), less the epoch: add that to what it returns."""
        shown = t + self.offset + self.drift * t
        for jump in self.jumps:
            after = t - jump.at
            shown = shown + np.where(after >= 0.0, jump.offset + jump.drift * after, 0.0)
        return shown


@dataclass(frozen=True, slots=True)
class Inertial:
    """Samples of accelerometer (m/s², with gravity), gyroscope (rad/s) and compass (µT) in the phone's axes.

    Attributes:
        t: (n,) world seconds.
        values: (n, 9), columns as in ``IMU_COLUMNS``.
    """

    t: Array
    values: Array


@dataclass(frozen=True, slots=True)
class PhoneScan:
    """What a phone heard in one scan at world time ``t``: addresses and whole dBm."""

    t: float
    kind: Literal["wifi", "ble"]
    address: tuple[str, ...]
    rssi: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class PhoneBatch:
    """One batch of one phone. All times are world seconds; the phone itself knows only what its clock shows.

    Attributes:
        person: who carries it.
        seq: counts the phone's batches; the same one again is a duplicate.
        measured_until: when the stretch of time it tells about ended.
        sent: when the phone sends it.
        arrival: when the gateway has it.
        clock: the phone's.
        inertial: None where there are no samples.
        scans: in order of time.
        step_t: (k,) true ends of steps, for tests and benchmarks; never sent.
        step_length: (k,) metres, likewise.
    """

    person: str
    seq: int
    measured_until: float
    sent: float
    arrival: float
    clock: PhoneClock
    inertial: Inertial | None
    scans: tuple[PhoneScan, ...]
    step_t: Array
    step_length: Array

    @property
    def sent_stamp(self) -> float:
        """What the phone's clock shows when it sends, less the epoch."""
        return float(self.clock.read(np.array([self.sent]))[0])

    @property
    def imu(self) -> dict[str, Array] | None:
        """The inertial columns by name as the gateway takes them, ``t`` on the phone's clock less the epoch."""
        if self.inertial is None:
            return None
        columns = {"t": self.clock.read(self.inertial.t)}
        columns.update(zip(IMU_COLUMNS, self.inertial.values.T, strict=True))
        return columns

    @property
    def scan_stamps(self) -> Array:
        """When the scans were made on the phone's clock less the epoch, (s,)."""
        return self.clock.read(np.array([scan.t for scan in self.scans]))
