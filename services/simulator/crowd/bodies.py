"""What do bodies do besides following their way? They lag, sway with the stride, shift their weight and look round.

The way is a point's, with corners and sudden stops; a body's middle follows it like a critically damped spring, swings
a few centimetres to the side of the standing foot, and never stands like a post. Where it faces follows the walk with
the inertia of a body, or wanders about what is looked at.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from services.simulator.seeds import generator

__all__ = ["Bodies"]

Array = NDArray[np.float64]

_STIFFNESS = 6.0  # 1/s: the body is 2/6 s behind its way
_SWAY = (0.015, 0.035)  # metres to each side at the stride frequency
_SURGE = 0.008  # metres to and fro at the step frequency
_CADENCE = 1.86  # steps a second at 1.3 m/s
_WEIGHT = 0.03  # standard deviation of shifting weight, metres
_WEIGHT_SECONDS = 1.1
_GLANCE = 0.3  # standard deviation of looking round, radians
_GLANCE_SECONDS = 2.2
_MOVING = 0.22  # m/s from which a body faces where it goes
_TURN_RATE = 2.8  # rad/s at most
_TURN_CHANGE = 9.0  # rad/s² at most


class Bodies:
    """The bodies of everybody, at steps of ``dt`` seconds.

    Attributes:
        position: (p, 2) metres; meaningless for who is away.
        heading: (p,), radians, continuous.
        speed: (p,), m/s along the way, without sway.
        walked: (p,), metres.
    """

    def __init__(self, count: int, seed: int, dt: float) -> None:
        self._dt = dt
        self._rng = generator(seed, "crowd", "bodies")
        self._middle = np.zeros((count, 2))
        self._velocity = np.zeros((count, 2))
        self._turning = np.zeros(count)
        self._sway = self._rng.uniform(*_SWAY, count)
        self._cadence = _CADENCE * np.clip(self._rng.normal(1.0, 0.06, count), 0.85, 1.15)
        self._phase = self._rng.uniform(0.0, math.tau, count)
        self._noise = np.zeros((count, 3))  # weight x, y, glance: first of two low passes
        self._smooth = np.zeros((count, 3))
        self._stillness = np.ones(count)
        self.position = np.zeros((count, 2))
        self.heading = np.zeros(count)
        self.speed = np.zeros(count)
        self.walked = np.zeros(count)

    @property
    def middle(self) -> Array:
        """The middle of each body without sway, (p, 2)."""
        return self._middle

    def appear(self, person: int, place: Array, heading: float) -> None:
        """Let a person stand at (2,), facing ``heading``."""
        self._middle[person] = self.position[person] = place
        self._velocity[person] = 0.0
        # A heading stays continuous over comings and goings; it is only read while somebody is about.
        self.heading[person] += math.remainder(heading - self.heading[person], math.tau)
        self._turning[person] = self.speed[person] = 0.0

    def step(self, way: Array, facing: Array) -> None:
        """Follow (p, 2) places on the way; face (p,) radians, or where one goes if that is NaN."""
        dt, decay = self._dt, math.exp(-_STIFFNESS * self._dt)
        before = self._middle.copy()
        error = self._middle - way
        push = (self._velocity + _STIFFNESS * error) * dt
        self._middle = way + (error + push) * decay
        self._velocity = (self._velocity - _STIFFNESS * push) * decay
        moved = np.hypot(*(self._middle - before).T)
        self.speed = np.hypot(*self._velocity.T)
        # Standing, what remains of the spring is no walk.
        self.walked = self.walked + np.where(self.speed > 0.03, moved, 0.0)
        self._wander()
        self._turn(facing)
        self._swing()

    def _wander(self) -> None:
        dt = self._dt
        seconds = np.array([_WEIGHT_SECONDS, _WEIGHT_SECONDS, _GLANCE_SECONDS])
        keep = np.exp(-dt / seconds)
        # Two equal low passes in a row: the second's variance is (1 + k²) / (1 - k²)³ · (1 - k)⁴ of white noise.
        gain = np.sqrt((1.0 - keep**2) ** 3 / (1.0 + keep**2)) / (1.0 - keep) ** 2
        noise = gain * self._rng.normal(size=self._noise.shape)
        self._noise = keep * self._noise + (1.0 - keep) * noise
        self._smooth = keep * self._smooth + (1.0 - keep) * self._noise
        still = np.clip(1.0 - self.speed / 0.4, 0.0, 1.0)
        self._stillness = self._stillness + (still - self._stillness) * (1.0 - math.exp(-dt / 0.7))

    def _turn(self, facing: Array) -> None:
        going = np.arctan2(self._velocity[:, 1], self._velocity[:, 0])
        wanted = np.where(np.isnan(facing) | (self.speed > 2.0 * _MOVING), going, facing)
        glance = _GLANCE * self._smooth[:, 2] * (0.2 + 0.8 * self._stillness)
        error = wanted + glance - self.heading
        error = error - math.tau * np.round(error / math.tau)
        # Who neither walks nor looks at anything keeps facing the same way.
        error = np.where(np.isnan(facing) & (self.speed < _MOVING), 0.0, error)
        rate = np.clip(3.5 * error, -_TURN_RATE, _TURN_RATE)
        limit = _TURN_CHANGE * self._dt
        self._turning = self._turning + np.clip(rate - self._turning, -limit, limit)
        self.heading = self.heading + self._turning * self._dt

    def _swing(self) -> None:
        frequency = self._cadence * np.sqrt(np.maximum(self.speed, 0.25) / 1.3)
        walking = np.clip(self.speed / 0.5, 0.0, 1.0)
        self._phase = (self._phase + math.pi * frequency * walking * self._dt) % math.tau
        ahead = np.stack([np.cos(self.heading), np.sin(self.heading)], axis=1)
        left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
        side = self._sway * walking * np.sin(self._phase)
        surge = _SURGE * walking * np.sin(2.0 * self._phase)
        weight = _WEIGHT * self._stillness[:, None] * self._smooth[:, :2]
        self.position = self._middle + side[:, None] * left + surge[:, None] * ahead + weight
