"""What do a walking person's phone sensors read? Accelerometer, gyroscope and compass in the phone's own axes.

The phone's attitude is a rotation sequence (heading, then how it is held, then how it wobbles); the gyroscope is the
difference of successive attitudes, so that integrating it gives the attitude back, and accelerometer and compass are
the world's vectors seen from it. In the hand: vertical and forward harmonics of the step, sideways at the stride
[self-calibrating-rss-thesis §3.5]. In the pocket: the thigh's pendulum [nonvisual-visual-fusion-dissertation §8].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

__all__ = ["FIELD_DIP", "FIELD_STRENGTH", "GRAVITY", "Gait", "InertialSamples", "PhoneSensors", "step_frequency"]

Array = NDArray[np.float64]
Carrying = Literal["hand", "pocket"]

GRAVITY = 9.81
FIELD_STRENGTH = 48.0
"""Total magnetic field, µT."""
FIELD_DIP = math.radians(62.0)
"""Angle by which the field points below the horizon (central Europe)."""
_STILL = 0.2  # below this speed, m/s, nobody takes steps


@dataclass(frozen=True, slots=True)
class Gait:
    """How one person walks.

    Attributes:
        cadence: steps a second at 1.3 m/s.
        vertical: amplitude of the vertical acceleration at the step frequency at 1.3 m/s, m/s².
        forward: the same along the walk.
        sideways: at the stride frequency.
    """

    cadence: float
    vertical: float
    forward: float
    sideways: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Gait:
        """Return somebody's gait: strides differ from person to person by some 6 %."""
        return cls(
            cadence=float(1.86 * np.clip(rng.normal(1.0, 0.06), 0.85, 1.15)),
            vertical=float(rng.uniform(1.9, 2.8)),
            forward=float(rng.uniform(0.8, 1.4)),
            sideways=float(rng.uniform(0.5, 0.9)),
        )


@dataclass(frozen=True, slots=True)
class InertialSamples:
    """Sensor readings in the phone's axes (x right, y to the top, z out of the screen), each (n, 3).

    Attributes:
        acceleration: m/s², gravity included.
        rotation: rad/s.
        field: µT.
        steps: true number of steps taken by each sample, (n,), for tests.
    """

    acceleration: Array
    rotation: Array
    field: Array
    steps: Array


def step_frequency(gait: Gait, speed: Array) -> Array:
    """Return steps a second, (n,), at ``speed`` (n,) m/s: people walk faster half by cadence, half by longer steps."""
    frequency: Array = gait.cadence * np.sqrt(np.maximum(speed, 0.25) / 1.3)
    return np.where(speed > _STILL, frequency, 0.0)


class PhoneSensors:
    """The sensors of one phone on one person; sampled in stretches that follow each other.

    Args:
        rng: decides gait, grip, biases and noise.
        north: direction of the compass's north on the plan, radians counter-clockwise from +x.
        carrying: held before the body, or in a trouser pocket.
        rate: samples a second.
    """

    def __init__(self, rng: np.random.Generator, north: float, carrying: Carrying = "hand", rate: float = 50.0) -> None:
        self.gait = Gait.draw(rng)
        self.carrying = carrying
        self._rng = rng
        self._dt = 1.0 / rate
        horizontal = FIELD_STRENGTH * math.cos(FIELD_DIP)
        self._field = np.array(
            [horizontal * math.cos(north), horizontal * math.sin(north), -FIELD_STRENGTH * math.sin(FIELD_DIP)]
        )
        if carrying == "hand":
            # Turned from the walk, raised at the top, tilted to a side: how this person holds it.
            self._grip = np.radians([rng.normal(0.0, 6.0), rng.uniform(15.0, 40.0), rng.normal(0.0, 4.0)])
        else:
            self._grip = rng.uniform(-math.pi, math.pi, 3) * np.array([1.0, 0.5, 1.0])
        self._mounting = Rotation.from_euler("ZXY", self._grip)
        self._gyro_bias = rng.normal(0.0, 0.008, 3)
        self._field_bias = rng.normal(0.0, 0.8, 3)
        self._phase = float(rng.uniform(0.0, 2.0 * math.pi))
        self._tempo = 0.0
        self._wander = np.zeros(3)
        self._strength = 0.0
        self._attitude: Rotation | None = None
        self._walked_phase = 0.0

    def sample(self, heading: Array, speed: Array) -> InertialSamples:
        """Return the readings of the next n samples, evenly spaced.

        Args:
            heading: where the body faces, (n,), radians counter-clockwise from the plan's +x, unwrapped.
            speed: (n,), m/s.
        """
        n, rng, dt = len(speed), self._rng, self._dt
        # No two steps are alike: the tempo wanders by some 3 %.
        tempo = self._drift(self._tempo, n, seconds=1.5, sigma=0.03)
        self._tempo = float(tempo[-1])
        frequency = step_frequency(self.gait, speed) * (1.0 + tempo)
        phase = self._phase + 2.0 * math.pi * dt * np.cumsum(frequency)
        steps = self._walked_phase + (phase - self._phase) / (2.0 * math.pi)
        self._phase, self._walked_phase = float(phase[-1]), float(steps[-1])
        # Amplitude follows the speed; starting and stopping take a third of a second.
        wanted = np.where(speed > _STILL, np.clip(speed / 1.3, 0.35, 1.4), 0.0)
        share = dt / (dt + 0.12)
        strength, _ = lfilter([share], [1.0, share - 1.0], wanted, zi=[(1.0 - share) * self._strength])
        self._strength = float(strength[-1])
        wander = np.column_stack([self._drift(self._wander[axis], n, 4.0, math.radians(2.5)) for axis in range(3)])
        self._wander = wander[-1]

        motion = self._hand if self.carrying == "hand" else self._pocket
        attitude, body = motion(phase, strength, frequency, heading, wander)
        cos, sin = np.cos(heading), np.sin(heading)
        world = np.column_stack(
            [cos * body[:, 0] - sin * body[:, 1], sin * body[:, 0] + cos * body[:, 1], body[:, 2] + GRAVITY]
        )
        acceleration = attitude.apply(world, inverse=True) + rng.normal(0.0, 0.12, (n, 3))
        return InertialSamples(
            acceleration=acceleration,
            rotation=self._rotation_rate(attitude) + self._gyro_bias + rng.normal(0.0, 0.01, (n, 3)),
            field=attitude.apply(self._field, inverse=True) + self._field_bias + rng.normal(0.0, 0.5, (n, 3)),
            steps=steps,
        )

    def _hand(
        self, phase: Array, strength: Array, frequency: Array, heading: Array, wander: Array
    ) -> tuple[Rotation, Array]:
        """Return attitude (phone to plan) and acceleration (n, 3) forward, left, up, of a phone before the body."""
        gait = self.gait
        wobble = strength[:, None] * np.column_stack(
            [0.025 * np.sin(0.5 * phase), 0.02 * np.sin(phase + 0.4), 0.02 * np.sin(0.5 * phase + 1.1)]
        )
        # Held along the walk, the phone's y axis is the heading: x, to its right, lies 90 degrees clockwise of that.
        angles = self._grip + wander + wobble
        angles[:, 0] += heading - 0.5 * math.pi
        body = np.column_stack(
            [
                gait.forward * (np.sin(phase + 0.6) + 0.25 * np.sin(2.0 * phase)),
                gait.sideways * np.sin(0.5 * phase + 0.9),
                gait.vertical * (np.cos(phase) + 0.3 * np.cos(2.0 * phase + 0.8)),
            ]
        )
        return Rotation.from_euler("ZXY", angles), body * strength[:, None]

    def _pocket(
        self, phase: Array, strength: Array, frequency: Array, heading: Array, wander: Array
    ) -> tuple[Rotation, Array]:
        """Return the same for a phone that swings with a thigh, 0.35 m below the hip, mounted any way round."""
        arm, cycle = 0.35, 0.5 * phase
        turning = math.pi * frequency
        big, small = math.radians(22.0) * strength, math.radians(6.0) * strength
        pitch = big * np.sin(cycle) + small * np.sin(2.0 * cycle + 0.7)
        rate = turning * (big * np.cos(cycle) + 2.0 * small * np.cos(2.0 * cycle + 0.7))
        turn = -(turning**2) * (big * np.sin(cycle) + 4.0 * small * np.sin(2.0 * cycle + 0.7))
        forward = arm * (turn * np.cos(pitch) - rate**2 * np.sin(pitch)) + 1.2 * strength * np.sin(2.0 * cycle + 0.3)
        up = arm * (turn * np.sin(pitch) + rate**2 * np.cos(pitch)) + 2.0 * strength * np.sin(2.0 * cycle + 1.5)
        left = 1.2 * strength * np.sin(cycle + 1.1)
        thigh = Rotation.from_euler("ZY", np.column_stack([heading + wander[:, 0], -pitch]))
        return thigh * self._mounting, np.column_stack([forward, left, up])

    def _rotation_rate(self, attitude: Rotation) -> Array:
        before = attitude[:1] if self._attitude is None else self._attitude
        earlier = Rotation.concatenate([before, attitude[:-1]])
        self._attitude = attitude[-1:]
        rate: Array = (earlier.inv() * attitude).as_rotvec() / self._dt
        return rate

    def _drift(self, start: float, n: int, seconds: float, sigma: float) -> Array:
        """Return (n,) of a random wander about zero that forgets itself within ``seconds``."""
        keep = math.exp(-self._dt / seconds)
        kicks = self._rng.normal(0.0, sigma * math.sqrt(1.0 - keep * keep), n)
        wander: Array = lfilter([1.0], [1.0, -keep], kicks, zi=[keep * start])[0]
        return wander
