"""Where is everybody by sight alone, with one guess at who is who? Global nearest neighbour on Kalman filters.

A constant-velocity Kalman filter per track; detections of each frame go to tracks by the assignment with the highest
product of measurement likelihoods; no appearance [ravel-thesis §10, EV-Loc step 1; §16]. It cannot take a decision
back: who is mistaken for somebody else stays so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from benchmarks.baselines.anonymous_tracks import AnonymousTracks, TrackRows
from benchmarks.baselines.sightings import Sightings
from benchmarks.world_record import WorldRecord
from services.fusion.positions.kalman_bank import innovations, predict, start, update

__all__ = ["ConstantVelocityParameters", "follow", "track"]

Array = NDArray[np.float64]

FORBIDDEN = 1e6
"""Cost of a pair outside the gate: more than any number of pairs inside."""


@dataclass(frozen=True, slots=True)
class ConstantVelocityParameters:
    """The settings of the tracker.

    Attributes:
        acceleration: white acceleration, m/s² in one second [ravel-thesis §16].
        speed: standard deviation of a new person's velocity along each axis, m/s.
        gate: squared Mahalanobis distance beyond which a detection is somebody else; 9.21 holds 99 % of the right ones.
        confirm: detections in consecutive frames of its first camera after which a track is believed; one miss before
            ends it.
        coast: seconds without a detection after which a believed track is dropped.
        frames_per_s: frames above this rate are left out; None takes all.
    """

    acceleration: float = 0.6
    speed: float = 1.0
    gate: float = 9.21
    confirm: int = 3
    coast: float = 2.0
    frames_per_s: float | None = None

    def __post_init__(self) -> None:
        """Refuse settings without a meaning."""
        for name in ("acceleration", "speed", "gate", "confirm", "coast"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: {getattr(self, name)} is not allowed; it must be positive")


def track(record: WorldRecord, times: Array, parameters: ConstantVelocityParameters | None = None) -> AnonymousTracks:
    """Return the tracks of the record's detections at ``times`` (n,); causal."""
    return follow(Sightings.of(record.frames), times, parameters)


def follow(sightings: Sightings, times: Array, parameters: ConstantVelocityParameters | None = None) -> AnonymousTracks:
    """Return the tracks at ``times`` (n,), not decreasing, each from the frames until then."""
    chosen = parameters or ConstantVelocityParameters()
    if chosen.frames_per_s is not None:
        sightings = sightings.thinned(chosen.frames_per_s)
    rows = TrackRows(times)
    bank = _Bank(chosen)
    begins, cameras = sightings.start.tolist(), sightings.camera.tolist()
    for frame, t in enumerate(sightings.t.tolist()):
        bank.report(rows, until=t)
        piece = slice(begins[frame], begins[frame + 1])
        bank.see(t, cameras[frame], sightings.position[piece], sightings.noise[piece])
    bank.report(rows, until=math.inf)
    return rows.tracks()


class _Bank:
    """All tracks as arrays."""

    def __init__(self, parameters: ConstantVelocityParameters) -> None:
        self._parameters = parameters
        self._t = 0.0
        self._next = 0
        self._mean: Array = np.zeros((0, 4))
        self._covariance: Array = np.zeros((0, 4, 4))
        self._id = np.zeros(0, np.int64)
        self._hits = np.zeros(0, np.int64)
        self._seen: Array = np.zeros(0)
        self._camera = np.zeros(0, np.int64)

    def see(self, t: float, camera: int, positions: Array, noise: Array) -> None:
        """Take in one frame of one camera."""
        chosen = self._parameters
        self._keep(t - self._seen <= chosen.coast)
        if len(self._id):
            predict(self._mean, self._covariance, t - self._t, chosen.acceleration**2)
        self._t = t
        new = np.ones(len(positions), bool)
        if len(self._id) and len(positions):
            _, distance, log_determinant = innovations(self._mean, self._covariance, positions, noise)
            cost = np.where(distance < chosen.gate, distance + log_determinant, FORBIDDEN)
            mine, theirs = linear_sum_assignment(cost)
            inside = cost[mine, theirs] < FORBIDDEN
            mine, theirs = mine[inside], theirs[inside]
            self._mean[mine], self._covariance[mine] = update(
                self._mean[mine], self._covariance[mine], positions[theirs], noise[theirs]
            )
            self._hits[mine] += 1
            self._seen[mine] = t
            new[theirs] = False
        self._keep((self._hits >= chosen.confirm) | (self._seen == t) | (self._camera != camera))
        if new.any():
            self._start(camera, positions[new], noise[new])

    def report(self, rows: TrackRows, until: float) -> None:
        """Answer for the times before ``until``, carrying believed tracks on from the last frame."""
        for place in rows.due(until):
            t = float(rows.times[place])
            here = (self._hits >= self._parameters.confirm) & (t - self._seen <= self._parameters.coast)
            rows.add(place, self._id[here], self._mean[here, :2] + (t - self._t) * self._mean[here, 2:])

    def _start(self, camera: int, positions: Array, noise: Array) -> None:
        mean, covariance = start(positions, noise, self._parameters.speed)
        n = len(positions)
        self._mean = np.concatenate([self._mean, mean])
        self._covariance = np.concatenate([self._covariance, covariance])
        self._id = np.concatenate([self._id, np.arange(self._next, self._next + n)])
        self._hits = np.concatenate([self._hits, np.ones(n, np.int64)])
        self._seen = np.concatenate([self._seen, np.full(n, self._t)])
        self._camera = np.concatenate([self._camera, np.full(n, camera)])
        self._next += n

    def _keep(self, keep: NDArray[np.bool_]) -> None:
        if not keep.all():
            self._mean, self._covariance = self._mean[keep], self._covariance[keep]
            self._id, self._hits = self._id[keep], self._hits[keep]
            self._seen, self._camera = self._seen[keep], self._camera[keep]
