"""When does a phone listen? Scans at a regular rate, throttled as by Android, or adverts heard window by window."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from shared.site.site_file import Number, Part

__all__ = ["AdvertScans", "RegularScans", "ScanSchedule", "ScanTimes", "ThrottledScans", "reports"]

Array = NDArray[np.float64]


class RegularScans(Part):
    """One scan after the other, as the phones of the original studies did: 1, 2 or 10 Hz."""

    kind: Literal["regular"] = "regular"
    every: Annotated[Number, Field(ge=0.02, le=3600, description="seconds between two scans")] = 1.0
    jitter: Annotated[Number, Field(ge=0, le=0.45, description="of a scan's time, as a share of `every`")] = 0.05


class ThrottledScans(Part):
    """Android since version 9 in the foreground: so many Wi-Fi scans per so many seconds, as soon as allowed."""

    kind: Literal["throttled"]
    burst: Annotated[int, Field(ge=1, le=100, description="scans that are allowed …")] = 4
    per: Annotated[Number, Field(gt=0, le=7200, description="… in so many seconds")] = 120.0
    every: Annotated[Number, Field(gt=0, le=600, description="seconds a scan takes; within a burst")] = 4.0
    jitter: Annotated[Number, Field(ge=0, le=0.45, description="of a scan's time, as a share of `every`")] = 0.1

    @model_validator(mode="after")
    def _fits(self) -> ThrottledScans:
        if self.burst * self.every > self.per:
            raise ValueError(
                f"{self.burst} scans of {self.every:g} s take longer than per = {self.per:g} s; "
                f"allowed: burst x every <= per"
            )
        return self


class AdvertScans(Part):
    """Bluetooth adverts come all the time; a phone reports what it heard window by window, each beacon once."""

    kind: Literal["adverts"]
    rate: Annotated[Number, Field(ge=0.1, le=50, description="adverts a second; 5 to 10 usually")] = 7.0
    window: Annotated[Number, Field(ge=0.1, le=600, description="seconds of adverts in one report")] = 1.0
    jitter: Annotated[Number, Field(ge=0, le=0.45, description="of an advert's time, as a share of its interval")] = 0.1

    @model_validator(mode="after")
    def _at_least_one(self) -> AdvertScans:
        if self.rate * self.window < 1.0:
            raise ValueError(
                f"a window of {self.window:g} s holds no advert at {self.rate:g} a second; allowed: rate x window >= 1"
            )
        return self


ScanSchedule = Annotated[RegularScans | ThrottledScans | AdvertScans, Field(discriminator="kind")]


class ScanTimes:
    """The scan times of one phone: a pure function of schedule and seed, however they are asked for.

    Args:
        schedule: how the phone listens.
        rng: draws the phase and the jitter; used here only.
    """

    def __init__(self, schedule: RegularScans | ThrottledScans | AdvertScans, rng: np.random.Generator) -> None:
        self.schedule = schedule
        if isinstance(schedule, AdvertScans):
            self._interval, self._burst, self._period = 1.0 / schedule.rate, 1, 1.0 / schedule.rate
        elif isinstance(schedule, ThrottledScans):
            self._interval, self._burst, self._period = schedule.every, schedule.burst, schedule.per
        else:
            self._interval, self._burst, self._period = schedule.every, 1, schedule.every
        self._phase = float(rng.uniform(0.0, self._period))
        self._key = np.uint64(rng.integers(0, 2**63))

    def times(self, start: float, end: float) -> Array:
        """Return the times in [start, end) at which the phone measures, (n,), increasing, world seconds.

        Any cut of a stretch of time into blocks gives the same times. For adverts these are those of the single
        adverts; ``reports`` makes windows of them.
        """
        first = math.floor((start - self._phase) / self._period) - 1
        last = math.ceil((end - self._phase) / self._period) + 1
        period = np.repeat(np.arange(first, last + 1), self._burst)
        place = np.tile(np.arange(self._burst), last + 1 - first)
        nominal = self._phase + period * self._period + place * self._interval
        shift = (_uniform(self._key, period * self._burst + place) - 0.5) * self.schedule.jitter * self._interval
        when: Array = nominal + shift
        return when[(when >= start) & (when < end)]


def reports(schedule: RegularScans | ThrottledScans | AdvertScans, t: Array, readings: Array) -> tuple[Array, Array]:
    """Return what the phone reports of its ``readings`` (n, k) at times ``t`` (n,): the same, but adverts by windows.

    Windows begin at whole multiples of their length in world time, so that blocks of whole windows cut none. A report
    bears the time of its last advert and holds each beacon's mean over those heard, whole dBm, NaN where none was.

    Returns:
        times (m,) and readings (m, k), m <= n.
    """
    if not isinstance(schedule, AdvertScans) or not len(t):
        return t, readings
    window = np.floor(t / schedule.window)
    first = np.flatnonzero(np.r_[True, np.diff(window) > 0])
    heard = np.isfinite(readings)
    count = np.add.reduceat(heard.astype(float), first, axis=0)
    total = np.add.reduceat(np.where(heard, readings, 0.0), first, axis=0)
    mean = np.round(np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0))
    return t[np.r_[first[1:] - 1, len(t) - 1]], mean


def _uniform(key: np.uint64, index: NDArray[np.int64]) -> Array:
    """Return numbers in [0, 1) that look random, one for each (key, index): SplitMix64 (Steele et al., 2014)."""
    with np.errstate(over="ignore"):
        z = key + index.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    uniform: Array = (z >> np.uint64(11)).astype(float) / 2.0**53
    return uniform
