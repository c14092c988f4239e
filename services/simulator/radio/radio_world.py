"""What would a phone hear here? A seeded radio world: path loss, and what path loss does not know.

Received power = P0 - 10 n log10(d) + shadowing(place, facing) - walls and obstacles between - storeys - the carrier's
body + drift of the access point + what this phone reads too much + small-scale fading + white noise, in whole dBm; weak
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

from services.simulator.radio.radio_changes import MovedAccessPoint, NewWall, PowerChange, RadioChange, unknown_names
from services.simulator.radio.radio_fading import Drift, Fading
from services.simulator.radio.shadowing import Lattice, ShadowingField, TabulatedFields
from services.simulator.radio.wall_loss import Barriers, LinkLoss
from services.simulator.seeds import generator
from shared.site import AccessPoint, Site
from shared.site.site_file import Number, Part

__all__ = ["PHONE_HEIGHT", "PhoneRadio", "RadioParameters", "RadioWorld", "ShadowingField"]

Array = NDArray[np.float64]

PHONE_HEIGHT = 1.2
"""Metres above the floor at which people hold their phones."""
STOREY = 3.5
"""Metres from floor to floor."""
_FINEST = 0.1  # metres between nodes of tabulated shadowing
_FEATURES = 256  # waves of a field
_CELL = 0.2  # metres: how fine the edges of walls' shadows are
_AROUND = 6.0  # metres around the outline in which people outside the door are still heard

Decibels = Annotated[Number, Field(ge=0, le=30)]


class RadioParameters(Part):
    """How far the radio world is from the site file's guesses, and how noisy it is. Powers in dB or dBm."""

    power_sigma: Decibels = Field(3.0, description="spread of the true P0 about the site file's, dB")
    exponent_sigma: Annotated[Number, Field(ge=0, le=2)] = Field(
        0.2, description="spread of the true path-loss exponent about the site file's"
    )
    shadowing_sigma: Decibels = Field(3.2, description="standard deviation of the field of shadowing, dB")
    shadowing_length: Annotated[Number, Field(ge=0.2, le=100)] = Field(
        2.5, description="metres after which shadowing's correlation is 1/e"
    )
    wall_loss: Decibels = Field(2.0, description="dB for each wall of the plan between phone and access point")
    obstacle_loss: Decibels = Field(0.0, description="dB for each obstacle of the plan in between")
    most_wall_loss: Annotated[Number, Field(ge=0, le=100)] = Field(
        25.0, description="most dB that walls and obstacles take together: round corners power comes anyhow"
    )
    floor_loss: Annotated[Number, Field(ge=0, le=60)] = Field(
        15.0, description="dB for each storey between phone and access point; their walls are not counted then"
    )
    body_loss: Decibels = Field(
        6.5, description="dB lost when the carrier's body is right between phone and access point"
    )
    facing_sigma: Decibels = Field(
        3.0,
        description="what it adds or takes besides, place by place, to face another way: waves come by way of walls, "
        "and bodies and antennas favour some directions, dB",
    )
    device_sigma: Decibels = Field(3.0, description="spread of phones' offsets, dB")
    antenna_sigma: Decibels = Field(1.0, description="spread of what a phone hears of one access point more, dB")
    drift_sigma: Decibels = Field(1.0, description="slow drift of each access point, dB")
    drift_time: Annotated[Number, Field(ge=1, le=1e6)] = Field(
        1800.0, description="seconds after which drift's correlation is 1/e"
    )
    rice_factor: Annotated[Number, Field(ge=0, le=1000)] = Field(
        5.0, description="K of the small-scale fading of Wi-Fi: power of the steady wave over that of the scattered"
    )
    rice_factor_ble: Annotated[Number, Field(ge=0, le=1000)] = Field(
        1.8, description="the same for Bluetooth, narrow in frequency, on three channels that fade each by itself"
    )
    fading_length: Annotated[Number, Field(ge=0.01, le=10)] = Field(
        0.2, description="metres of movement after which fading is another"
    )
    fading_time: Annotated[Number, Field(ge=0.1, le=1e6)] = Field(
        60.0, description="seconds after which fading of a still phone is another, because people around it move"
    )
    flicker_sigma: Decibels = Field(0.6, description="quick wavering of the air, dB")
    flicker_time: Annotated[Number, Field(ge=0.05, le=1e4)] = Field(5.0, description="its correlation time, seconds")
    noise_sigma: Decibels = Field(1.1, description="white noise of each reading, dB")
    sensitivity: Annotated[Number, Field(ge=-120, le=-20)] = Field(
        -93.0, description="power at which half of the readings are missed, dBm"
    )
    sensitivity_slope: Annotated[Number, Field(ge=0.1, le=20)] = Field(
        1.5, description="how gently hearing fades around the sensitivity: the scale of a logistic curve, dB"
    )
    always_missed: Annotated[Number, Field(ge=0, lt=1)] = Field(
        0.02, description="share of readings missed however strong the access point is"
    )
    always_missed_ble: Annotated[Number, Field(ge=0, lt=1)] = Field(
        0.12, description="the same of Bluetooth adverts: receivers listen to one channel at a time"
    )
    changes: list[RadioChange] = Field([], description="what changes while the world runs")


@dataclass(frozen=True, slots=True)
class _Place:
    """Where an access point hangs from some time on; one column of the arrays below."""

    point: str
    number: int
    since: float
    position: tuple[float, float, float]
    floor: str


class RadioWorld:
    """The true radio of one site. Same site, seeds and parameters: the same world, bit for bit.

    Access points' constants and shadowing are of ``seed``; phones and what drifts are of ``day``, which is ``seed`` too
    unless another is given.

    Attributes:
        access_points: site ids of the access points, in the order of every array's last axis.
        power_1m: their true P0 in the beginning, (k,), dBm.
        exponent: their true path-loss exponents, (k,).
        ble: which of them are Bluetooth beacons, (k,).
        floors: ids of the site's floors.

    Raises:
        ValueError: a change names a floor or an access point that the site does not have; or the site does not say
            where an access point hangs.
    """

    def __init__(
        self, site: Site, seed: int, parameters: RadioParameters | None = None, day: int | None = None
    ) -> None:
        self.parameters = parameters or RadioParameters()
        self.seed = seed
        self.day = seed if day is None else day
        unknown = unknown_names(self.parameters.changes, site)
        if unknown:
            raise ValueError("; ".join(unknown))
        chosen = self.parameters
        self.floors: Sequence[str] = [floor.id for floor in site.floors]
        self._levels: Mapping[str, int] = {floor.id: floor.level for floor in site.floors}
        self.access_points: Sequence[str] = [point.id for point in site.access_points]
        self.ble: NDArray[np.bool_] = np.array([point.kind == "ble" for point in site.access_points], dtype=bool)
        constants = np.array([self._constants(point) for point in site.access_points]).reshape(-1, 2)
        self.power_1m: Array = constants[:, 0]
        self.exponent: Array = constants[:, 1]
        names = self.access_points
        self._drift = Drift(
            [generator(self.day, "drift", name) for name in names], chosen.drift_sigma, chosen.drift_time
        )
        self._power_changes = [
            (change.at, names.index(change.access_point), change.by)
            for change in chosen.changes
            if isinstance(change, PowerChange)
        ]
        self._places = [place for point in site.access_points for place in _places(point, chosen.changes)]
        self._column_of: list[list[int]] = [
            [column for column, place in enumerate(self._places) if place.point == name] for name in names
        ]
        self._position: Array = np.array([place.position for place in self._places]).reshape(-1, 3)
        self._column_exponent = self.exponent[[names.index(place.point) for place in self._places]]
        self._column_level = np.array([self._levels[place.floor] for place in self._places], dtype=np.int64)
        self._on_floor = {
            floor: np.array([n for n, place in enumerate(self._places) if place.floor == floor], dtype=np.int64)
            for floor in self.floors
        }
        self._shadowing: dict[str, TabulatedFields] = {}
        self._facing: dict[str, tuple[TabulatedFields, TabulatedFields] | None] = {}
        self._walls: dict[str, list[tuple[float, LinkLoss]]] = {}
        for floor in site.floors:
            corners = np.array(floor.outline)
            low, high = corners.min(axis=0) - _AROUND, corners.max(axis=0) + _AROUND
            fine = Lattice(low, high, max(_FINEST, chosen.shadowing_length / 12.0))
            self._shadowing[floor.id] = self._fields(floor.id, "shadowing", chosen.shadowing_sigma, fine)
            self._facing[floor.id] = None
            if chosen.facing_sigma > 0.0:
                self._facing[floor.id] = (
                    self._fields(floor.id, "facing x", chosen.facing_sigma, fine),
                    self._fields(floor.id, "facing y", chosen.facing_sigma, fine),
                )
            sources = self._position[self._on_floor[floor.id], :2]
            standing = Barriers.of(floor.plan(), chosen.wall_loss, chosen.obstacle_loss)
            coarse = Lattice(low, high, _CELL)
            self._walls[floor.id] = [
                (0.0, LinkLoss(standing, sources, coarse)),
                *(
                    (change.at, LinkLoss(Barriers([(change.line, change.loss)]), sources, coarse))
                    for change in chosen.changes
                    if isinstance(change, NewWall) and change.floor == floor.id
                ),
            ]

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
        gain = self._gain(points, floor, facing, times)
        power: Array = self.power_1m + self._drift.at(times)
        for since, column, by in self._power_changes:
            power[times >= since, column] += by
        index = np.empty(power.shape, np.int64)
        for column, places in enumerate(self._column_of):
            later = [self._places[place].since for place in places[1:]]
            index[:, column] = places[0] + (np.searchsorted(later, times, side="right") if later else 0)
        power += np.take_along_axis(gain, index, axis=1)
        return power

    def phone(self, device: str) -> PhoneRadio:
        """Return the radio of one phone: its own offsets and its own noise."""
        return PhoneRadio(self, generator(self.day, "phone radio", device))

    def _gain(self, points: Array, floor: str, facing: Array | None, t: Array) -> Array:
        """Return what the way from each place of an access point adds, (n, places), dB."""
        chosen = self.parameters
        toward_x, toward_y = (self._position[:, axis] - points[:, axis, None] for axis in (0, 1))
        storeys = np.abs(self._levels[floor] - self._column_level)
        rise = np.where(storeys == 0, self._position[:, 2] - PHONE_HEIGHT, STOREY * storeys)
        distance = np.sqrt(toward_x**2 + toward_y**2 + rise**2)
        gain: Array = -10.0 * self._column_exponent * np.log10(np.maximum(distance, 0.3))
        gain += self._shadowing[floor].at(points)
        gain -= chosen.floor_loss * storeys
        here = self._on_floor[floor]
        lost = np.zeros((len(points), len(here)))
        for since, walls in self._walls[floor]:
            standing = np.flatnonzero(t >= since) if since > 0.0 else slice(None)
            lost[standing] += walls.at(points[standing])
        gain[:, here] -= np.minimum(lost, chosen.most_wall_loss)
        gain -= 0.5 * chosen.body_loss
        if facing is not None:
            along_x, along_y = np.cos(facing)[:, None], np.sin(facing)[:, None]
            ahead = (toward_x * along_x + toward_y * along_y) / np.maximum(np.hypot(toward_x, toward_y), 0.1)
            gain += 0.5 * chosen.body_loss * ahead
            fields = self._facing[floor]
            if fields is not None:
                gain += fields[0].at(points) * along_x + fields[1].at(points) * along_y
        return gain

    def _constants(self, point: AccessPoint) -> tuple[float, float]:
        """Return an access point's true P0 and exponent."""
        chosen = self.parameters
        rng = generator(self.seed, "access point", point.id)
        power = point.power_1m + rng.normal(0.0, chosen.power_sigma)
        return power, max(1.0, point.path_loss_exponent + rng.normal(0.0, chosen.exponent_sigma))

    def _fields(self, floor: str, name: str, sigma: float, lattice: Lattice) -> TabulatedFields:
        """Return a floor's fields, one for each place of an access point."""
        length = self.parameters.shadowing_length
        return TabulatedFields(
            [
                ShadowingField(
                    generator(self.seed, name, place.point, str(place.number), floor), sigma, length, _FEATURES
                )
                for place in self._places
            ],
            lattice,
        )


def _places(point: AccessPoint, changes: Sequence[RadioChange]) -> list[_Place]:
    """Return where an access point hangs, in order of time."""
    if point.position is None:
        raise ValueError(f"access point {point.id} has no position")
    moves = [change for change in changes if isinstance(change, MovedAccessPoint) and change.access_point == point.id]
    spots = [(0.0, point.position), *((move.at, move.position) for move in sorted(moves, key=lambda move: move.at))]
    return [_Place(point.id, number, since, position, point.floor) for number, (since, position) in enumerate(spots)]


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
        most = 1.0 - np.where(self._world.ble, chosen.always_missed_ble, chosen.always_missed)
        heard = most * _logistic((power - chosen.sensitivity) / chosen.sensitivity_slope)
        readings: Array = np.where(self._hearing.random(power.shape) < heard, np.round(np.minimum(power, -1.0)), np.nan)
        return readings


def _logistic(value: Array) -> Array:
    squashed: Array = 0.5 * (1.0 + np.tanh(0.5 * value))
    return squashed
