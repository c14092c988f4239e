"""What are the phones like? The parameters of a number of phones of one kind: what they measure, and when they send."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from services.simulator.phones.carrying import Carrying, CarryingParameters
from services.simulator.phones.gait import SensorParameters
from services.simulator.phones.stride import StrideParameters
from services.simulator.radio.scan_schedule import AdvertScans, RegularScans, ScanSchedule
from shared.site.site_file import Identifier, Number, Part

__all__ = ["FleetParameters", "Flushes"]

Kind = Literal["wifi", "ble"]

_SAMPLES, _SCANS = 12_000, 200  # in one batch; what the gateway takes, see docs/phone-app.md


class Flushes(Part):
    """A phone with its screen off: measures on, and sends what waits when the system wakes its app."""

    every: Number = Field(ge=1, le=3600, description="seconds between two flushes at most; a tenth less at least")


class FleetParameters(Part):
    """A number of phones of one kind."""

    name: Identifier = Field("phone", description="the first part of their device ids off-line")
    count: int = Field(ge=1, le=2000, description="how many people carry one")
    carrying: Carrying = Field("hand", description="hand, pocket, or mixed: now here, now there")
    inertial_rate: Number = Field(50.0, ge=0, le=200, description="inertial samples a second, 0 for none, Hz")
    wifi: ScanSchedule | None = Field(
        default_factory=RegularScans, description="when it scans for Wi-Fi access points; null: never"
    )
    ble: ScanSchedule | None = Field(None, description="when it listens for Bluetooth beacons; null: never")
    batch_seconds: Number = Field(1.0, ge=0.2, le=120, description="of measurement in one batch, s")
    upload: Literal["live"] | Flushes = Field("live", description="live: at once; {every: s}: late, all that waits")
    network_delay: tuple[Number, Number] = Field((0.02, 0.25), description="least and greatest way to the gateway, s")
    clock_offset: tuple[Number, Number] = Field((1.0, 86_400.0), description="by which clocks are wrong, s")
    clock_drift: Number = Field(20.0, ge=0, le=1000, description="std of how fast or slow clocks run, ppm")
    sample_jitter: Number = Field(0.001, ge=0, le=0.01, description="by which a sample comes late at most, s")
    hole_every: Number = Field(60.0, ge=0, le=86_400, description="mean seconds between holes of 0.02-0.1 s; 0: never")
    sensors: SensorParameters = SensorParameters()
    stride: StrideParameters = StrideParameters()
    habits: CarryingParameters = CarryingParameters()

    @property
    def schedules(self) -> dict[Kind, ScanSchedule]:
        """How they listen, by kind of radio."""
        both: tuple[tuple[Kind, ScanSchedule | None], ...] = (("wifi", self.wifi), ("ble", self.ble))
        return {kind: schedule for kind, schedule in both if schedule is not None}

    @property
    def enrolled_as(self) -> Literal["hand", "pocket"]:
        """What their app tells the gateway: a heading may be taken for known only where the phone is always held.

        ``unknown`` promises that it is held flat or upright, and a phone that is sometimes in a pocket breaks that.
        """
        return "hand" if self.carrying == "hand" else "pocket"

    @property
    def hears(self) -> tuple[Kind, ...]:
        """Which kinds of radio they hear."""
        return tuple(self.schedules)

    @model_validator(mode="after")
    def _possible(self) -> FleetParameters:
        for name, most in (("network_delay", 600.0), ("clock_offset", 1e7)):
            low, high = getattr(self, name)
            if not 0.0 <= low <= high <= most:
                raise ValueError(f"{name} is [{low:g}, {high:g}], allowed is 0 <= least <= greatest <= {most:g} s")
        if 0.0 < self.inertial_rate < 20.0:
            raise ValueError(f"inertial_rate is {self.inertial_rate:g}, allowed is 0 (none) or 20 to 200 Hz")
        if not self.inertial_rate and not self.schedules:
            raise ValueError("inertial_rate is 0 and neither wifi nor ble is given: these phones would measure nothing")
        if self.inertial_rate * self.batch_seconds > _SAMPLES:
            raise ValueError(
                f"batch_seconds {self.batch_seconds:g} x inertial_rate {self.inertial_rate:g} is more than the "
                f"{_SAMPLES} samples that a gateway takes in a batch"
            )
        if self.upload != "live" and self.upload.every < 4.0 * self.batch_seconds:
            raise ValueError(
                f"upload.every is {self.upload.every:g}, "
                f"allowed is 4 x batch_seconds = {4 * self.batch_seconds:g} s or more"
            )
        scans = sum(_most(schedule, self.batch_seconds) for schedule in self.schedules.values())
        if scans > _SCANS:
            raise ValueError(
                f"batch_seconds {self.batch_seconds:g} holds up to {scans:.0f} scans, allowed is {_SCANS} in a batch"
            )
        return self


def _most(schedule: ScanSchedule, seconds: float) -> float:
    """Return how many reports there are in so many seconds at most."""
    return seconds / (schedule.window if isinstance(schedule, AdvertScans) else schedule.every) + 1.0
