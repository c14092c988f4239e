"""A small building site of nothing but numbers: phones, bystanders, one camera, and constants the filter knows.

Set up as the numerical check of the method sheet [ravel-thesis §17]. What the sheet leaves open is decided here: people
walk from waypoint to waypoint at 0.5 to 1.1 m/s and pause for 2 to 15 s; access points stand on an ellipse around the
site, at the height of phones; there are two steps in a second, and a compass errs anew every second.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.radio import PathLoss
from shared.radio.path_loss import DEVICE_HEIGHT

__all__ = ["DEPTH", "WIDTH", "ReferenceRecord", "ReferenceWorld", "ring", "walk"]

Array = NDArray[np.float64]

WIDTH, DEPTH = 11.0, 9.0
"""Metres, of the floor that the camera sees."""
POWER, EXPONENT = -40.0, 2.2
"""dBm at one metre, and the path-loss exponent; the filter knows both."""
STEPS_PER_S = 2


def walk(rng: np.random.Generator, t: Array, people: int) -> tuple[Array, NDArray[np.bool_]]:
    """Walk from waypoint to waypoint with pauses; return positions (n, p, 2) and who moves (n, p)."""
    positions = np.empty((len(t), people, 2))
    moving = np.zeros((len(t), people), bool)
    for person in range(people):
        now, at = 0.0, rng.uniform([0.5, 0.5], [WIDTH - 0.5, DEPTH - 0.5])
        corners, times = [at], [now]
        while now < t[-1] - t[0]:
            goal = rng.uniform([0.5, 0.5], [WIDTH - 0.5, DEPTH - 0.5])
            now += float(np.hypot(*(goal - at))) / rng.uniform(0.5, 1.1)
            corners.append(goal)
            times.append(now)
            now += rng.uniform(2.0, 15.0)
            corners.append(goal)
            times.append(now)
            at = goal
        since = t - t[0]
        for axis in range(2):
            positions[:, person, axis] = np.interp(since, times, np.array(corners)[:, axis])
        moving[:, person] = np.searchsorted(times, since, side="left") % 2 == 1
    return positions, moving


def ring(access_points: int) -> Array:
    """Return the places (m, 2) of access points around the site, metres."""
    around = np.linspace(0.0, 2.0 * np.pi, access_points, endpoint=False)
    return np.column_stack([5.5 + 6.5 * np.cos(around), 4.5 + 5.5 * np.sin(around)])


@dataclass(frozen=True)
class ReferenceRecord:
    """What a filter is told each second, and the truth.

    Attributes:
        radio: the constants of M access points.
        positions: (n, K, 2) metres, of the K phones' carriers.
        shift: (n, K, 2) metres that their steps say they walked in the second before.
        reading: (n, M, K) dBm.
        sightings: n arrays (d, 2) of detections, metres.
    """

    radio: PathLoss
    positions: Array
    shift: Array
    reading: Array
    sightings: list[Array]


@dataclass(frozen=True)
class ReferenceWorld:
    """The world of one row of the table; defaults are the sheet's.

    Attributes:
        access_points: all heard all the time.
        heading: standard deviation, degrees.
        devices: people with a phone.
        bystanders: people without.
        seconds: one cycle each.
        detected: probability while moving and while still.
        camera: metres, along each axis.
        false_per_frame: detections of nobody.
        radio: dB, from one reading to the next.
        missed_steps: share.
    """

    access_points: int = 6
    heading: float = 10.0
    devices: int = 5
    bystanders: int = 3
    seconds: int = 60
    detected: tuple[float, float] = (0.85, 0.3)
    camera: float = 0.25
    false_per_frame: float = 0.5
    radio: float = 4.0
    missed_steps: float = 0.07

    def record(self, seed: int) -> ReferenceRecord:
        """Return what happens in a run; runs of one seed have the same people and detections."""
        rng = np.random.default_rng(seed)
        half = np.arange(STEPS_PER_S * self.seconds + 1) / STEPS_PER_S
        paths, moves = walk(rng, half, self.devices + self.bystanders)
        positions, moving = paths[STEPS_PER_S::STEPS_PER_S], moves[STEPS_PER_S::STEPS_PER_S]
        seen = rng.random(moving.shape) < np.where(moving, *self.detected)
        noisy = positions + rng.normal(0.0, self.camera, positions.shape)
        sightings = []
        for place, found in zip(noisy, seen, strict=True):
            false = rng.uniform([0.0, 0.0], [WIDTH, DEPTH], (rng.poisson(self.false_per_frame), 2))
            sightings.append(rng.permutation(np.concatenate([place[found], false])))
        carried = positions[:, : self.devices]
        places = np.column_stack([ring(self.access_points), np.full(self.access_points, DEVICE_HEIGHT)])
        radio = PathLoss(
            names=tuple(f"ap-{place}" for place in range(self.access_points)),
            positions=places,
            power_1m=np.full(self.access_points, POWER),
            exponent=np.full(self.access_points, EXPONENT),
        )
        level = radio.rssi(carried.reshape(-1, 2)).reshape(self.seconds, self.devices, self.access_points)
        shift = self._steps(rng, paths[:, : self.devices])
        reading = (level + rng.normal(0.0, self.radio, level.shape)).transpose(0, 2, 1)
        return ReferenceRecord(radio, carried, shift, reading, sightings)

    def _steps(self, rng: np.random.Generator, paths: Array) -> Array:
        """Return (n, K, 2) metres walked in each second by what phones say of it."""
        steps = np.diff(paths, axis=0).reshape(self.seconds, STEPS_PER_S, -1, 2)
        told = rng.random(steps.shape[:3]) >= self.missed_steps
        walked = (steps * told[..., None]).sum(axis=1)
        turn = np.radians(self.heading) * rng.standard_normal(walked.shape[:2])
        cos, sin = np.cos(turn), np.sin(turn)
        return np.stack(
            [cos * walked[..., 0] - sin * walked[..., 1], sin * walked[..., 0] + cos * walked[..., 1]], axis=-1
        )
