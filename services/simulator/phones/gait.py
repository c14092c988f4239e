"""What do a walking person's phone sensors read? Accelerometer, gyroscope and compass in the phone's own axes.

The phone's attitude is a chain of rotations: where the body faces, how thigh or hand swing, how the phone is held
(``phones.carrying``). The gyroscope is the difference of successive attitudes, so that integrating it gives the
attitude back; accelerometer and compass are the world's vectors seen from it. In the hand: vertical and forward
harmonics of the step, sideways at the stride [self-calibrating-rss-thesis §3.5]. In the pocket: the thigh's pendulum
[nonvisual-visual-fusion-dissertation §8].
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.signal import butter, lfilter

from services.simulator.phones.carrying import Carried, Carrying, CarryingParameters, Habit
from services.simulator.phones.stride import Steps, Stride, StrideParameters, StrideRhythm
from shared.site.site_file import Number, Part

__all__ = ["GRAVITY", "Gait", "InertialSamples", "PhoneSensors", "SensorParameters"]

Array = NDArray[np.float64]

GRAVITY = 9.81
_STILL = 0.2  # below this speed, m/s, legs hardly swing
_STARTS = 0.12  # seconds in which a walk gets its swing, and loses it
_TURNS = 0.1  # seconds in which a phone follows its carrier's turn
_HANDLING = (0.6, 3.5)  # Hz; fingers and arms are about as quick as steps
_TWISTS = math.radians(2.5)  # of a phone that is handled, per axis; at these frequencies one radian a second or two
_YIELDS = math.radians(2.5)  # of a hand or a cloth that holds a phone
_YIELDING = (3.3, 0.7)  # seconds in which it forgets where it was, and in which it forgets how it moves


class SensorParameters(Part):
    """The sensors of a phone's price class."""

    gyro_bias: Number = Field(0.005, ge=0, le=0.2, description="std of a phone's constant gyroscope bias, rad/s")
    gyro_drift: Number = Field(0.001, ge=0, le=0.1, description="std of what wanders about it within minutes, rad/s")
    gyro_noise: Number = Field(0.008, ge=0, le=0.5, description="white, rad/s")
    accelerometer_bias: Number = Field(0.06, ge=0, le=2, description="std of a phone's accelerometer bias, m/s²")
    accelerometer_noise: Number = Field(0.08, ge=0, le=5, description="white, m/s²")
    pocket_noise: Number = Field(0.6, ge=0, le=5, description="more of it in a swinging pocket, m/s²")
    compass_bias: Number = Field(1.2, ge=0, le=30, description="std of what calibration leaves, per axis, µT")
    compass_noise: Number = Field(0.5, ge=0, le=10, description="white, µT")


@dataclass(frozen=True, slots=True)
class Gait:
    """How one person's body moves in walking; accelerations are amplitudes at 1.3 m/s.

    Attributes:
        vertical: at the step frequency, m/s².
        forward: the same along the walk.
        sideways: at the stride frequency.
        limp: how much harder one foot strikes than the other, as a share.
        swing: of the thigh, radians.
    """

    vertical: float
    forward: float
    sideways: float
    limp: float
    swing: float

    @classmethod
    def draw(cls, rng: np.random.Generator) -> Gait:
        """Return somebody's gait."""
        return cls(
            vertical=float(rng.uniform(1.9, 2.8)),
            forward=float(rng.uniform(0.8, 1.4)),
            sideways=float(rng.uniform(0.5, 0.9)),
            limp=float(np.clip(rng.normal(0.0, 0.08), -0.2, 0.2)),
            swing=math.radians(rng.uniform(19.0, 25.0)),
        )


@dataclass(frozen=True, slots=True)
class InertialSamples:
    """Sensor readings in the phone's axes (x right, y to the top, z out of the screen), each (n, 3), and the truth.

    Attributes:
        acceleration: m/s², gravity included.
        rotation: rad/s.
        field: µT.
        attitude: (n, 3, 3) true rotations from the phone's axes to the plan's.
        steps: the true steps.
        carried: how the phone was carried.
    """

    acceleration: Array
    rotation: Array
    field: Array
    attitude: Array
    steps: Steps
    carried: Carried


class PhoneSensors:
    """The sensors of one phone on one person; sampled in stretches that follow each other.

    Args:
        rng: decides gait, grip, biases and noise.
        carrying: held before the body, in a trouser pocket, or by turns.
        rate: samples a second, nominally.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        carrying: Carrying = "hand",
        rate: float = 50.0,
        sensors: SensorParameters | None = None,
        stride: StrideParameters | None = None,
        habits: CarryingParameters | None = None,
    ) -> None:
        stride = stride or StrideParameters()
        self.gait = Gait.draw(rng)
        self.stride = Stride.draw(rng, stride)
        self._own = sensors or SensorParameters()
        self._habits = habits or CarryingParameters()
        self._rng = rng
        self._dt = 1.0 / rate
        # Parts with generators of their own: one more fidget changes no step.
        rhythm, habit, self._handling = rng.spawn(3)
        self._rhythm = StrideRhythm(rhythm, self.stride, stride.irregularity)
        self._habit = Habit(habit, carrying, self._habits)
        self._gyro_bias = rng.normal(0.0, 1.0, 3) * self._own.gyro_bias
        self._gyro_drift = rng.normal(0.0, 1.0, 3) * self._own.gyro_drift
        self._accelerometer_bias = rng.normal(0.0, 1.0, 3) * self._own.accelerometer_bias
        self._compass_bias = rng.normal(0.0, 1.0, 3) * self._own.compass_bias
        self._wander = np.zeros((2, 3))
        self._follows: Array | None = None
        self._attitude: Array | None = None
        self._t = 0.0
        poles, zeros = butter(2, _HANDLING, "bandpass", fs=rate)
        response = lfilter(poles, zeros, np.eye(1, int(20.0 * rate))[0])
        self._shaking = poles / np.linalg.norm(response), zeros  # white noise in, standard deviation 1 out
        self._shake = np.zeros((4, 6))

    def restart(self) -> None:
        """Go on after a time of which nothing is known."""
        self._rhythm.restart()
        self._follows = self._attitude = None

    def sample(self, t: Array, heading: Array, speed: Array, walked: Array, field: Array) -> InertialSamples:
        """Return the readings of the next n samples.

        Args:
            t: (n,) seconds, increasing, about ``1 / rate`` apart.
            heading: where the body faces, (n,), radians counter-clockwise from the plan's +x, unwrapped.
            speed: (n,), m/s.
            walked: (n,), metres walked so far.
            field: of the Earth and the building at the phone, (n, 3) µT in plan axes.
        """
        n, rng, own = len(t), self._rng, self._own
        steps = self._rhythm.follow(t, walked, speed)
        carried = self._habit.follow(t, speed)
        heading, strength = self._inertia(heading, speed)
        phase = 2.0 * math.pi * steps.count
        body = carried.push + strength[:, None] * self._in_hand(phase) * carried.hand[:, None]
        wander = self._wandering(n)
        angles = wander + (carried.hand * strength)[:, None] * _sway(phase)
        loose = 1.0 - carried.hand
        if loose.any():
            swing, acceleration = self._in_pocket(phase, strength, self.stride.cadence(speed))
            angles[:, 1] -= loose * swing
            body += loose[:, None] * acceleration
        if carried.fidget.any():
            shaking = carried.fidget[:, None] * self._handled(n)
            # Who fidgets with a phone in the pocket moves a leg.
            weight = 1.0 - 0.6 * loose[:, None]
            body += weight * self._habits.fidget_strength * (shaking[:, :3] + carried.rhythm)
            angles += weight * _TWISTS * shaking[:, 3:]
        angles[:, 2] += heading
        attitude = _turned(angles) @ carried.mount
        cos, sin = np.cos(heading), np.sin(heading)
        world = np.column_stack(
            [cos * body[:, 0] - sin * body[:, 1], sin * body[:, 0] + cos * body[:, 1], body[:, 2] + GRAVITY]
        )
        noise = rng.normal(size=(n, 9))
        impact = own.accelerometer_noise + own.pocket_noise * strength * loose
        readings = InertialSamples(
            acceleration=_seen(attitude, world) + self._accelerometer_bias + impact[:, None] * noise[:, :3],
            rotation=self._rotation_rate(t, attitude) + self._bias(n) + own.gyro_noise * noise[:, 3:6],
            field=_seen(attitude, field) + self._compass_bias + own.compass_noise * noise[:, 6:],
            attitude=attitude,
            steps=steps,
            carried=carried,
        )
        self._t = float(t[-1])
        return readings

    def _inertia(self, heading: Array, speed: Array) -> tuple[Array, Array]:
        """Return heading and strength of the walk, (n,) each, as a body has them: nothing begins from one moment on."""
        wanted = np.where(speed > _STILL, np.clip(speed / 1.3, 0.35, 1.5), np.maximum(speed, 0.0) / 1.3)
        if self._follows is None:
            self._follows = np.array([heading[0], wanted[0]])
        share = self._dt / (self._dt + _TURNS)
        turned, _ = lfilter([share], [1.0, share - 1.0], heading, zi=[(1.0 - share) * self._follows[0]])
        share = self._dt / (self._dt + _STARTS)
        strength, _ = lfilter([share], [1.0, share - 1.0], wanted, zi=[(1.0 - share) * self._follows[1]])
        self._follows = np.array([turned[-1], strength[-1]])
        return turned, strength

    def _in_hand(self, phase: Array) -> Array:
        """Return the acceleration (n, 3) forward, left, up, m/s², of a phone before the body."""
        gait = self.gait
        foot = 1.0 + gait.limp * np.sin(0.5 * phase)
        return np.column_stack(
            [
                gait.forward * (np.sin(phase + 0.6) + 0.25 * np.sin(2.0 * phase)),
                gait.sideways * np.sin(0.5 * phase + 0.9),
                gait.vertical * foot * (np.cos(phase) + 0.3 * np.cos(2.0 * phase + 0.8)),
            ]
        )

    def _in_pocket(self, phase: Array, strength: Array, cadence: Array) -> tuple[Array, Array]:
        """Return pitch (n,) of the thigh, radians, and acceleration (n, 3) of a phone 0.35 m below the hip."""
        arm, cycle = 0.35, 0.5 * phase
        turning = math.pi * cadence
        big, small = self.gait.swing * strength, math.radians(6.0) * strength
        pitch = big * np.sin(cycle) + small * np.sin(2.0 * cycle + 0.7)
        rate = turning * (big * np.cos(cycle) + 2.0 * small * np.cos(2.0 * cycle + 0.7))
        turn = -(turning**2) * (big * np.sin(cycle) + 4.0 * small * np.sin(2.0 * cycle + 0.7))
        forward = arm * (turn * np.cos(pitch) - rate**2 * np.sin(pitch)) + 1.2 * strength * np.sin(2.0 * cycle + 0.3)
        up = arm * (turn * np.sin(pitch) + rate**2 * np.cos(pitch)) + 2.0 * strength * np.sin(2.0 * cycle + 1.5)
        left = 1.2 * strength * np.sin(cycle + 1.1)
        return pitch, np.column_stack([forward, left, up])

    def _wandering(self, n: int) -> Array:
        """Return how a hand or a cloth yields, (n, 3) radians: two low passes in a row, so that it turns at a rate."""
        slow, quick = (math.exp(-self._dt / seconds) for seconds in _YIELDING)
        # The variance of white noise after both is (1 + s q) / ((1 - s q) (1 - s²) (1 - q²)).
        both = slow * quick
        gain = math.sqrt((1.0 - both) * (1.0 - slow * slow) * (1.0 - quick * quick) / (1.0 + both))
        kicks = self._rng.normal(0.0, _YIELDS * gain, (n, 3))
        push: Array = lfilter([1.0], [1.0, -quick], kicks, axis=0, zi=quick * self._wander[:1])[0]
        wander: Array = lfilter([1.0], [1.0, -slow], push, axis=0, zi=slow * self._wander[1:])[0]
        self._wander = np.stack([push[-1], wander[-1]])
        return wander.copy()

    def _handled(self, n: int) -> Array:
        """Return accelerations and turns of fingers and arms, (n, 6), std 1."""
        shaking: Array
        shaking, self._shake = lfilter(*self._shaking, self._handling.normal(size=(n, 6)), axis=0, zi=self._shake)
        return shaking

    def _bias(self, n: int) -> Array:
        """Return the gyroscope's bias, (n, 3): a constant, and what warms up and cools down within minutes."""
        keep = math.exp(-n * self._dt / 300.0)
        before = self._gyro_drift
        kick = self._rng.normal(0.0, 1.0, 3) * self._own.gyro_drift * math.sqrt(1.0 - keep * keep)
        self._gyro_drift = keep * before + kick
        share = (np.arange(1, n + 1) / n)[:, None]
        return self._gyro_bias + before + share * (self._gyro_drift - before)

    def _rotation_rate(self, t: Array, attitude: Array) -> Array:
        """Return the mean rate of turn since the sample before, (n, 3) rad/s in the phone's axes."""
        before = attitude[:1] if self._attitude is None else self._attitude
        earlier = np.concatenate([before, attitude[:-1]])
        since = t[0] - self._dt if self._attitude is None else self._t
        self._attitude = attitude[-1:]
        # sin(angle) times the axis is the antisymmetric part of earlier' x attitude.
        sine = np.empty((len(t), 3))
        for axis, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
            sine[:, axis] = 0.5 * (
                np.einsum("nk,nk->n", earlier[:, :, i], attitude[:, :, j])
                - np.einsum("nk,nk->n", earlier[:, :, j], attitude[:, :, i])
            )
        size = np.minimum(np.sqrt(np.einsum("nk,nk->n", sine, sine)), 1.0)
        scale = np.where(size > 1e-6, np.arcsin(size) / np.maximum(size, 1e-9), 1.0)
        rate: Array = sine * (scale / np.diff(t, prepend=since))[:, None]
        return rate


def _sway(phase: Array) -> Array:
    """Return how a phone in the hand of somebody walking at 1.3 m/s nods, (n, 3) radians about forward, left, up."""
    return np.column_stack([0.02 * np.sin(0.5 * phase + 1.1), -0.02 * np.sin(phase + 0.4), 0.025 * np.sin(0.5 * phase)])


def _turned(angles: Array) -> Array:
    """Return the rotations (n, 3, 3) about up, then left, then forward, by angles (n, 3) about forward, left, up."""
    (sx, sy, sz), (cx, cy, cz) = np.sin(angles).T, np.cos(angles).T
    turned = np.empty((len(angles), 3, 3))
    turned[:, 0, 0], turned[:, 0, 1], turned[:, 0, 2] = cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx
    turned[:, 1, 0], turned[:, 1, 1], turned[:, 1, 2] = sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx
    turned[:, 2, 0], turned[:, 2, 1], turned[:, 2, 2] = -sy, cy * sx, cy * cx
    return turned


def _seen(attitude: Array, vectors: Array) -> Array:
    """Return vectors (n, 3) of the plan in the phone's axes."""
    seen: Array = np.einsum("nij,ni->nj", attitude, vectors)
    return seen
