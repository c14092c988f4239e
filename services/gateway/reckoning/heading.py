"""Which way does the phone point? Attitude and heading from accelerometer, gyroscope and compass, streaming.

The one place where a compass heading becomes a direction on the plan is ``plan_heading``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from services.gateway.reckoning.resampling import RATE

__all__ = ["UNKNOWN_VARIANCE", "HeadingFilter", "Headings", "plan_heading"]

Array = NDArray[np.float64]

UNKNOWN_VARIANCE = math.pi**2 / 3
"""rad²: of a heading about which nothing is known (uniform on the circle)."""


def plan_heading(compass_heading_from_north_clockwise: Array, north: float) -> Array:
    """Return headings counter-clockwise from the plan's +x axis, in (-π, π].

    Args:
        compass_heading_from_north_clockwise: radians as a compass counts them: north 0, east π/2.
        north: direction of north on the plan, radians counter-clockwise from +x (``Site.north_radians``).
    """
    turned = north - compass_heading_from_north_clockwise
    return -((-turned + math.pi) % (2.0 * math.pi) - math.pi)


@dataclass(frozen=True, slots=True)
class Headings:
    """Compass headings of the phone's forward direction, one per sample."""

    heading: Array
    """(n,) radians clockwise from magnetic north, continuous (not wrapped)."""
    variance: Array
    """(n,) rad²."""


class HeadingFilter:
    """Complementary filter: gyroscope for the short, gravity and magnetic field for the long time constants.

    The blend of [self-calibrating-rss-thesis §3.2, Eqs. 3.14-3.17] written on the two vectors that matter instead of a
    direction-cosine matrix: the direction of gravity in the phone (time constant 1 s) and the angle between the gyro's
    heading and the compass's (8 s, from a few tried on the shopping-mall traces; averaged as a phasor, so that
    it knows no seam). Forward is the top of the phone or, where the phone is held upright, away from its screen.
    """

    GRAVITY_TAU = 1.0
    COMPASS_TAU = 8.0
    HAND_SIGMA = math.radians(12.0)
    """Of the heading of a phone in the hand against the walking direction: 7.5° median error on legs over 10 m."""
    FIELD = (15.0, 80.0)
    """µT; outside it the field is not the Earth's and the compass is left out."""
    UPRIGHT = 0.8

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._gravity: tuple[float, float, float] | None = None
        self._turned = 0.0
        self._phasor = 0j
        self._weight = 0.0

    def push(self, acceleration: Array, rotation: Array, field: Array | None) -> Headings:
        """Take samples ``1 / RATE`` apart, each (n, 3) in the phone's axes: m/s² with gravity, rad/s, µT (or None)."""
        up = self._follow_gravity(acceleration, rotation)
        up = up / np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
        turning = -np.einsum("ij,ij->i", rotation, up) / RATE  # clockwise is positive for a compass
        turned = self._turned + np.cumsum(turning)
        self._turned = float(turned[-1])
        decay = 1.0 - 1.0 / (self.COMPASS_TAU * RATE)
        difference = np.zeros(len(up), complex)
        trusted = np.zeros(len(up))
        if field is not None:
            strength = np.linalg.norm(field, axis=1)
            trusted = ((strength > self.FIELD[0]) & (strength < self.FIELD[1])).astype(float)
            difference = trusted * np.exp(1j * (_compass(up, field, self.UPRIGHT) - turned))
        phasor, _ = lfilter([1.0], [1.0, -decay], difference, zi=np.array([decay * self._phasor]))
        weight, _ = lfilter([1.0], [1.0, -decay], trusted, zi=np.array([decay * self._weight]))
        self._phasor, self._weight = complex(phasor[-1]), float(weight[-1])
        heading = turned + np.unwrap(np.angle(phasor))
        agreement = np.clip(np.abs(phasor) / np.maximum(weight, 1e-9), 1e-3, 1.0)
        variance = self.HAND_SIGMA**2 - 2.0 * np.log(agreement)
        known = weight > 1e-3 * RATE
        return Headings(heading, np.where(known, np.minimum(variance, UNKNOWN_VARIANCE), UNKNOWN_VARIANCE))

    def _follow_gravity(self, acceleration: Array, rotation: Array) -> Array:
        """Return the direction of "up" in the phone's axes, (n, 3): carried by the gyroscope, drawn by gravity."""
        blend = 1.0 / (self.GRAVITY_TAU * RATE)
        x, y, z = self._gravity or tuple(np.mean(acceleration[: int(RATE)], axis=0).tolist())
        up = []
        for (ax, ay, az), (p, q, r) in zip(acceleration.tolist(), (rotation / RATE).tolist(), strict=True):
            # A vector at rest in the room turns backwards in the phone: dv = -ω x v dt (Eq. 3.14).
            x, y, z = x - (q * z - r * y), y - (r * x - p * z), z - (p * y - q * x)
            x, y, z = x + blend * (ax - x), y + blend * (ay - y), z + blend * (az - z)
            up.append((x, y, z))
        self._gravity = (x, y, z)
        return np.array(up)


def _compass(up: Array, field: Array, upright: float) -> Array:
    """Return the tilt-compensated compass heading of the forward direction (n,), radians clockwise from north."""
    north = field - np.einsum("ij,ij->i", field, up)[:, None] * up
    (nx, ny, nz), (ux, uy, uz) = north.T, up.T
    # Of north and of east = north x up, only what lies along the phone's top (y) or back (-z).
    held_upright = uy > upright
    along_north = np.where(held_upright, -nz, ny)
    along_east = np.where(held_upright, ny * ux - nx * uy, nz * ux - nx * uz)
    heading: Array = np.arctan2(along_east, along_north)
    return heading
