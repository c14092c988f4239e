"""What would a phone hear here? A seeded radio world: path loss, and what path loss does not know.

Received power = P0 - 10 n log10(d) + shadowing(place) + floor loss + device offset + white noise, in whole dBm, and
weak access points are often not heard at all. The true P0 and n differ from the site file's guesses, and shadowing is
a random field that all phones share: what they cannot average away. Log-distance with correlated shadowing after
Gudmundson (1991), correlation exp(-distance / 3 m), drawn with random Fourier features (Rahimi and Recht, 2007).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.simulator.seeds import generator
from shared.site import AccessPoint, Site

__all__ = ["PHONE_HEIGHT", "PhoneRadio", "RadioParameters", "RadioWorld", "ShadowingField"]

Array = NDArray[np.float64]

PHONE_HEIGHT = 1.2
"""Metres above the floor at which people hold their phones."""


@dataclass(frozen=True, slots=True)
class RadioParameters:
    """How far the radio world is from the site file's guesses, and how noisy it is. Powers in dB or dBm."""

    power_sigma: float = 3.0
    exponent_sigma: float = 0.2
    shadowing_sigma: float = 4.0
    shadowing_length: float = 3.0
    device_sigma: float = 3.0
    noise_sigma: float = 2.2
    floor_loss: float = 15.0
    """Loss per storey between phone and access point."""
    sensitivity: float = -88.0
    """Power at which half of the readings are missed."""
    sensitivity_slope: float = 3.0
    """How gently hearing fades around the sensitivity: the scale of a logistic curve, dB."""
    always_missed: float = 0.02
    """Share of readings missed however strong the access point is."""


class ShadowingField:
    """A zero-mean Gaussian random field over the plan with correlation exp(-distance / length).

    Args:
        rng: draws the field; the field itself is then a pure function of the place.
        sigma: standard deviation, dB.
        length: correlation length, metres.
        features: number of random Fourier features.
    """

    def __init__(self, rng: np.random.Generator, sigma: float, length: float, features: int = 384) -> None:
        # The spectrum of the exponential correlation in the plane is a bivariate Student t with one degree of freedom.
        direction = rng.normal(size=(features, 2))
        spread = np.maximum(np.abs(rng.normal(size=(features, 1))), 1e-3)
        self._waves = (direction / spread / length).T
        self._phases = rng.uniform(0.0, 2.0 * np.pi, features)
        self._amplitude = sigma * np.sqrt(2.0 / features)

    def at(self, points: Array) -> Array:
        """Return the field in dB, (n,), at plan points (n, 2)."""
        field: Array = self._amplitude * np.cos(points @ self._waves + self._phases).sum(axis=1)
        return field


@dataclass(frozen=True, slots=True)
class _Transmitter:
    """An access point as it really is."""

    position: tuple[float, float, float]
    level: int
    power_1m: float
    exponent: float
    shadowing: ShadowingField


class RadioWorld:
    """The true radio of one site. Same site, seed and parameters: the same world, bit for bit.

    Attributes:
        access_points: site ids of the access points, in the order of every array's last axis.
        power_1m: their true P0, (k,), dBm.
        exponent: their true path-loss exponents, (k,).
    """

    def __init__(self, site: Site, seed: int, parameters: RadioParameters | None = None) -> None:
        self.parameters = parameters or RadioParameters()
        self.seed = seed
        self._levels: Mapping[str, int] = {floor.id: floor.level for floor in site.floors}
        self._transmitters = [self._draw(point) for point in site.access_points]
        self.access_points: Sequence[str] = [point.id for point in site.access_points]
        self.power_1m: Array = np.array([transmitter.power_1m for transmitter in self._transmitters])
        self.exponent: Array = np.array([transmitter.exponent for transmitter in self._transmitters])

    def expected(self, points: Array, floor: str) -> Array:
        """Return the power (n, k) in dBm that an average phone receives at plan points (n, 2) of ``floor``.

        The mean over white noise: shadowing is in it, device offset and misses are not. KeyError: no such floor.
        """
        points = np.asarray(points, float).reshape(-1, 2)
        level = self._levels[floor]
        power = np.empty((len(points), len(self._transmitters)))
        for column, source in enumerate(self._transmitters):
            x, y, z = source.position
            storeys = abs(level - source.level)
            rise = z - PHONE_HEIGHT if storeys == 0 else 3.5 * storeys
            distance = np.sqrt((points[:, 0] - x) ** 2 + (points[:, 1] - y) ** 2 + rise**2)
            path_loss = 10.0 * source.exponent * np.log10(np.maximum(distance, 0.3))
            shadowing = source.shadowing.at(points)
            power[:, column] = source.power_1m - path_loss + shadowing - self.parameters.floor_loss * storeys
        return power

    def phone(self, device: str) -> PhoneRadio:
        """Return the radio of one phone: its own offset and its own noise."""
        return PhoneRadio(self, generator(self.seed, "phone radio", device))

    def _draw(self, point: AccessPoint) -> _Transmitter:
        rng = generator(self.seed, "access point", point.id)
        chosen = self.parameters
        return _Transmitter(
            position=point.position,
            level=self._levels[point.floor],
            power_1m=point.power_1m + rng.normal(0.0, chosen.power_sigma),
            exponent=max(1.0, point.path_loss_exponent + rng.normal(0.0, chosen.exponent_sigma)),
            shadowing=ShadowingField(rng, chosen.shadowing_sigma, chosen.shadowing_length),
        )


class PhoneRadio:
    """One phone's receiver. Scans are drawn in order: the same sequence of calls gives the same readings.

    Attributes:
        offset: what this phone reads too much, dB.
    """

    def __init__(self, world: RadioWorld, rng: np.random.Generator) -> None:
        self._world = world
        self._rng = rng
        self.offset = float(rng.normal(0.0, world.parameters.device_sigma))

    def scan(self, points: Array, floor: str) -> Array:
        """Return readings (n, k), whole dBm, at plan points (n, 2); NaN where an access point was not heard."""
        chosen = self._world.parameters
        power = self._world.expected(points, floor) + self.offset
        power += self._rng.normal(0.0, chosen.noise_sigma, power.shape)
        heard = (1.0 - chosen.always_missed) * _logistic((power - chosen.sensitivity) / chosen.sensitivity_slope)
        readings: Array = np.where(self._rng.random(power.shape) < heard, np.round(np.minimum(power, -1.0)), np.nan)
        return readings


def _logistic(value: Array) -> Array:
    squashed: Array = 0.5 * (1.0 + np.tanh(0.5 * value))
    return squashed
