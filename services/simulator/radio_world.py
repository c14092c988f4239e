"""What would a phone hear here? A seeded radio world: path loss, and what path loss does not know.

Received power = P0 - 10 n log10(d) + shadowing(place) - walls and obstacles in between - storeys - the carrier's body
+ drift of the access point + what this phone reads too much + small-scale fading + white noise, in whole dBm; weak
access points are often not heard at all. The true P0 and n differ from the site file's guesses, walls are built and
access points move while the world runs. How large each part is, is fitted to recordings by ``atrium bench radio-fit``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from services.simulator.radio_changes import MovedAccessPoint, NewWall, PowerChange, RadioChange, unknown_names
from services.simulator.radio_fading import Drift, Fading
from services.simulator.seeds import generator
from services.simulator.shadowing import Lattice, ShadowingField, TabulatedField
from services.simulator.wall_loss import Barriers, LinkLoss
from shared.site import AccessPoint, Site
from shared.site.site_file import Number, Part

__all__ = ["PHONE_HEIGHT", "PhoneRadio", "RadioParameters", "RadioWorld", "ShadowingField"]

Array = NDArray[np.float64]

PHONE_HEIGHT = 1.2
"""Metres above the floor at which people hold their phones."""
STOREY = 3.5
"""Metres from floor to floor."""
_FINEST = 0.1  # metres between nodes of tabulated shadowing
_CELL = 0.2  # metres: how fine the edges of walls' shadows are
_AROUND = 6.0  # metres around the outline in which people outside the door are still heard

Decibels = Annotated[Number, Field(ge=0, le=30)]


class RadioParameters(Part):
    """How far the radio world is from the site file's guesses, and how noisy it is. Powers in dB or dBm."""

    power_sigma: Decibels = Field(3.0, description="spread of the true P0 about the site file's, dB")
    exponent_sigma: Annotated[Number, Field(ge=0, le=2)] = Field(
        0.2, description="spread of the true path-loss exponent about the site file's"
    )
    shadowing_sigma: Decibels = Field(3.0, description="standard deviation of the field of shadowing, dB")
    shadowing_length: Annotated[Number, Field(ge=0.2, le=100)] = Field(
        2.0, description="metres after which shadowing's correlation is 1/e"
    )
    wall_loss: Decibels = Field(4.0, description="dB for each wall of the plan between phone and access point")
    obstacle_loss: Decibels = Field(0.0, description="dB for each obstacle of the plan in between")
    most_wall_loss: Annotated[Number, Field(ge=0, le=100)] = Field(
        25.0, description="most dB that walls and obstacles take together: round corners power comes anyhow"
    )
    floor_loss: Annotated[Number, Field(ge=0, le=60)] = Field(
        15.0, description="dB for each storey between phone and access point; their walls are not counted then"
    )
    body_loss: Decibels = Field(
        4.5, description="dB lost when the carrier's body is right between phone and access point"
    )
    device_sigma: Decibels = Field(3.0, description="spread of phones' offsets, dB")
    antenna_sigma: Decibels = Field(1.0, description="spread of what a phone hears of one access point more, dB")
    drift_sigma: Decibels = Field(1.5, description="slow drift of each access point, dB")
    drift_time: Annotated[Number, Field(ge=1, le=1e6)] = Field(
        900.0, description="seconds after which drift's correlation is 1/e"
    )
    rice_factor: Annotated[Number, Field(ge=0, le=1000)] = Field(
        2.5, description="K of the small-scale fading of Wi-Fi: power of the steady wave over that of the scattered"
    )
    rice_factor_ble: Annotated[Number, Field(ge=0, le=1000)] = Field(
        1.2, description="the same for Bluetooth, narrow in frequency, on three channels that fade each by itself"
    )
    fading_length: Annotated[Number, Field(ge=0.01, le=10)] = Field(
        0.2, description="metres of movement after which fading is another"
    )
    fading_time: Annotated[Number, Field(ge=0.1, le=1e6)] = Field(
        60.0, description="seconds after which fading of a still phone is another, because people around it move"
    )
    flicker_sigma: Decibels = Field(0.6, description="quick wavering of the air, dB")
    flicker_time: Annotated[Number, Field(ge=0.05, le=1e4)] = Field(5.0, description="its correlation time, seconds")
    noise_sigma: Decibels = Field(1.3, description="white noise of each reading, dB")
    sensitivity: Annotated[Number, Field(ge=-120, le=-20)] = Field(
        -90.0, description="power at which half of the readings are missed, dBm"
    )
    sensitivity_slope: Annotated[Number, Field(ge=0.1, le=20)] = Field(
        2.5, description="how gently hearing fades around the sensitivity: the scale of a logistic curve, dB"
    )
    always_missed: Annotated[Number, Field(ge=0, lt=1)] = Field(
        0.02, description="share of readings missed however strong the access point is"
    )
    changes: list[RadioChange] = Field([], description="what changes while the world runs")


@dataclass(frozen=True, slots=True)
class _Place:
    """Where an access point hangs from some time on, and what is particular to that place."""

    since: float
    position: Array
    shadowing: Mapping[str, TabulatedField]
    walls: LinkLoss


@dataclass(frozen=True, slots=True)
class _AddedWall:
    since: float
    floor: str
    barriers: Barriers


@dataclass(frozen=True, slots=True)
class _Transmitter:
    """An access point as it really is."""

    floor: str
    level: int
    power_1m: float
    exponent: float
    places: Sequence[_Place]
    added_walls: Sequence[tuple[float, Sequence[LinkLoss]]]
    """When a wall was added to its floor, and its loss for each of ``places``."""
    power_changes: Sequence[tuple[float, float]]
    drift: Drift


class RadioWorld:
    """The true radio of one site. Same site, seed and parameters: the same world, bit for bit.

    Attributes:
        access_points: site ids of the access points, in the order of every array's last axis.
        power_1m: their true P0 in the beginning, (k,), dBm.
        exponent: their true path-loss exponents, (k,).
        ble: which of them are Bluetooth beacons, (k,).

    Raises:
        ValueError: a change names a floor or an access point that the site does not have.
    """

    def __init__(self, site: Site, seed: int, parameters: RadioParameters | None = None) -> None:
        self.parameters = parameters or RadioParameters()
        self.seed = seed
        unknown = unknown_names(self.parameters.changes, site)
        if unknown:
            raise ValueError("; ".join(unknown))
        chosen = self.parameters
        self.floors: Sequence[str] = [floor.id for floor in site.floors]
        self._levels: Mapping[str, int] = {floor.id: floor.level for floor in site.floors}
        outlines = {floor.id: np.array(floor.outline) for floor in site.floors}
        self._coarse, self._fine = (
            {
                floor: Lattice(corners.min(axis=0) - _AROUND, corners.max(axis=0) + _AROUND, spacing)
                for floor, corners in outlines.items()
            }
            for spacing in (_CELL, max(_FINEST, chosen.shadowing_length / 15.0))
        )
        self._barriers = {
            floor.id: Barriers.of(floor.plan(), chosen.wall_loss, chosen.obstacle_loss) for floor in site.floors
        }
        self._transmitters = [self._draw(point) for point in site.access_points]
        self.access_points: Sequence[str] = [point.id for point in site.access_points]
        self.power_1m: Array = np.array([transmitter.power_1m for transmitter in self._transmitters])
        self.exponent: Array = np.array([transmitter.exponent for transmitter in self._transmitters])
        self.ble: NDArray[np.bool_] = np.array([point.kind == "ble" for point in site.access_points], dtype=bool)

    def expected(
        self, points: ArrayLike, floor: str, heading: ArrayLike | None = None, t: ArrayLike | None = None
    ) -> Array:
        """Return the power in dBm, (n, k), that an average phone receives: the mean over fading, noise and phones.

        Args:
            points: (n, 2), metres on the plan of ``floor``.
            floor: its id. KeyError: there is no such floor.
            heading: where the carrier faces, (n,) or one, radians counter-clockwise from +x; None for the mean over
                all headings.
            t: world seconds, (n,) or one; None for the beginning.
        """
        points = np.asarray(points, float).reshape(-1, 2)
        count = len(points)
        times = np.broadcast_to(np.asarray(0.0 if t is None else t, float), (count,))
        facing = None if heading is None else np.broadcast_to(np.asarray(heading, float), (count,))
        level = self._levels[floor]
        power = np.empty((count, len(self._transmitters)))
        for column, source in enumerate(self._transmitters):
            power[:, column] = source.power_1m + source.drift.at(times)
            for since, by in source.power_changes:
                power[times >= since, column] += by
            index = np.searchsorted([place.since for place in source.places[1:]], times, side="right")
            for number in range(len(source.places)):
                here = slice(None) if len(source.places) == 1 else np.flatnonzero(index == number)
                power[here, column] += self._from_place(
                    source, number, points[here], floor, level, None if facing is None else facing[here], times[here]
                )
        return power

    def phone(self, device: str) -> PhoneRadio:
        """Return the radio of one phone: its own offsets and its own noise."""
        return PhoneRadio(self, generator(self.seed, "phone radio", device))

    def _from_place(
        self, source: _Transmitter, number: int, points: Array, floor: str, level: int, facing: Array | None, t: Array
    ) -> Array:
        """Return the gain, (n,) dB, of a transmitter that hangs at the given one of its places."""
        chosen = self.parameters
        place = source.places[number]
        storeys = abs(level - source.level)
        same_floor = floor == source.floor
        toward = place.position[:2] - points
        rise = place.position[2] - PHONE_HEIGHT if storeys == 0 else STOREY * storeys
        distance = np.sqrt(toward[:, 0] ** 2 + toward[:, 1] ** 2 + rise**2)
        gain = -10.0 * source.exponent * np.log10(np.maximum(distance, 0.3))
        gain += place.shadowing[floor].at(points)
        gain -= chosen.floor_loss * storeys
        if same_floor:
            lost = place.walls.at(points)
            for since, losses in source.added_walls:
                lost = lost + np.where(t >= since, losses[number].at(points), 0.0)
            gain -= np.minimum(lost, chosen.most_wall_loss)
        if facing is None:
            gain -= 0.5 * chosen.body_loss
        else:
            bearing = np.arctan2(toward[:, 1], toward[:, 0])
            gain -= 0.5 * chosen.body_loss * (1.0 - np.cos(bearing - facing))
        return gain

    def _draw(self, point: AccessPoint) -> _Transmitter:
        chosen = self.parameters
        rng = generator(self.seed, "access point", point.id)
        power = point.power_1m + rng.normal(0.0, chosen.power_sigma)
        exponent = max(1.0, point.path_loss_exponent + rng.normal(0.0, chosen.exponent_sigma))
        moves = [
            change
            for change in chosen.changes
            if isinstance(change, MovedAccessPoint) and change.access_point == point.id
        ]
        spots = [(0.0, point.position), *((move.at, move.position) for move in sorted(moves, key=lambda move: move.at))]
        lattice = self._coarse[point.floor]
        places = [
            _Place(
                since,
                np.array(position),
                self._shadowing(point.id, number),
                LinkLoss(self._barriers[point.floor], np.array(position[:2]), lattice),
            )
            for number, (since, position) in enumerate(spots)
        ]
        added = [
            (
                change.at,
                [LinkLoss(Barriers([(change.line, change.loss)]), place.position[:2], lattice) for place in places],
            )
            for change in chosen.changes
            if isinstance(change, NewWall) and change.floor == point.floor
        ]
        return _Transmitter(
            floor=point.floor,
            level=self._levels[point.floor],
            power_1m=power,
            exponent=exponent,
            places=places,
            added_walls=added,
            power_changes=[
                (change.at, change.by)
                for change in chosen.changes
                if isinstance(change, PowerChange) and change.access_point == point.id
            ],
            drift=Drift(generator(self.seed, "drift", point.id), chosen.drift_sigma, chosen.drift_time),
        )

    def _shadowing(self, point: str, place: int) -> dict[str, TabulatedField]:
        """Return the fields of an access point at one of its places, a field for each floor that hears it."""
        chosen = self.parameters
        return {
            floor: TabulatedField(
                ShadowingField(
                    generator(self.seed, "shadowing", point, str(place), floor),
                    chosen.shadowing_sigma,
                    chosen.shadowing_length,
                ),
                self._fine[floor],
            )
            for floor in self.floors
        }


class PhoneRadio:
    """One phone's receiver. Readings are drawn in order: the same scans give the same readings, however cut in calls.

    Attributes:
        offset: what this phone reads too much, dB.
        antenna: what it reads too much of each access point besides, (k,), dB.
    """

    def __init__(self, world: RadioWorld, rng: np.random.Generator) -> None:
        chosen = world.parameters
        self._world = world
        own, fading, self._noise, self._hearing = rng.spawn(4)
        self.offset = float(own.normal(0.0, chosen.device_sigma))
        self.antenna: Array = own.normal(0.0, chosen.antenna_sigma, len(world.access_points))
        self._fading = Fading(
            fading,
            np.where(world.ble, chosen.rice_factor_ble, chosen.rice_factor),
            world.ble,
            chosen.fading_length,
            chosen.fading_time,
            chosen.flicker_sigma,
            chosen.flicker_time,
        )

    def scan(
        self, t: ArrayLike, points: ArrayLike, floors: str | Sequence[str], heading: ArrayLike | None = None
    ) -> Array:
        """Return readings (n, k), whole dBm, NaN where an access point was not heard.

        Args:
            t: world seconds of n scans (or of one), never decreasing, from call to call either.
            points: (n, 2), metres on the plan.
            floors: floor id of each scan, or one for all. KeyError: there is no such floor.
            heading: where the carrier faces, (n,), radians counter-clockwise from +x; None for the mean over headings.

        Raises:
            ValueError: the arguments are not of one length.
        """
        times = np.atleast_1d(np.asarray(t, float))
        places = np.asarray(points, float).reshape(-1, 2)
        facing = None if heading is None else np.atleast_1d(np.asarray(heading, float))
        names = [floors] * len(times) if isinstance(floors, str) else list(floors)
        lengths = [len(times), len(places), len(names), len(times) if facing is None else len(facing)]
        if len(set(lengths)) > 1:
            raise ValueError("t, points, floors and heading differ in length: {}, {}, {}, {}".format(*lengths))
        chosen = self._world.parameters
        index = np.array([self._world.floors.index(name) if name in self._world.floors else -1 for name in names])
        if (index < 0).any():
            raise KeyError(
                f"{names[int(np.argmax(index < 0))]!r} is no floor; allowed: {', '.join(self._world.floors)}"
            )
        power = np.empty((len(times), len(self._world.access_points)))
        for number in np.unique(index):
            rows = np.flatnonzero(index == number)
            power[rows] = self._world.expected(
                places[rows], self._world.floors[number], None if facing is None else facing[rows], times[rows]
            )
        power += self.offset + self.antenna + self._fading.along(times, places, index)
        power += chosen.noise_sigma * self._noise.standard_normal(power.shape)
        heard = (1.0 - chosen.always_missed) * _logistic((power - chosen.sensitivity) / chosen.sensitivity_slope)
        readings: Array = np.where(self._hearing.random(power.shape) < heard, np.round(np.minimum(power, -1.0)), np.nan)
        return readings


def _logistic(value: Array) -> Array:
    squashed: Array = 0.5 * (1.0 + np.tanh(0.5 * value))
    return squashed
