"""How much do cameras speak for each track? The incremental log-likelihood ratio of its detections.

By the terms of [ravel-thesis §8.1, Eq. 5.1] (``shared.sight_nats``), for detections that fed the track; no look counts
nothing. Predicted means from the frame before: the place a track
is told at has already taken the detection in. The sheet looks once a second, and what a detector gets wrong lasts about
as long; so a look counts for the time since the camera's look before, and a score does not depend on the frame rate.

p_d and clutter are counted per camera as frames come, with forgetting; so is by how much innovations are larger than
what tracker and camera say of them. Fusion's ``rescore/sight.py`` uses the same terms and fixes all of that, because it
compares detectors: here tracks are compared, and what is usual of the cameras in use is to be taken off.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from shared.messages import DetectionFrame, TrackFrame
from shared.sight_nats import assigned_nats, missed_nats, off_by
from shared.site import ViewMap

__all__ = ["SightScore"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

CYCLE = 1.0
"""Seconds that count as one look."""
LOOK = 0.1
"""Seconds between two frames that are scored, at least: more of them say nothing new."""
MEMORY = 600.0
"""Seconds after which what was counted of a camera weighs 1/e."""
WAITING = 32
"""Frames of a camera kept until tracks of their time come; later ones push them out."""
SAME = 1e-3
"""Seconds by which times that are the same may differ."""
ACCELERATION = 1.0
"""Standard deviation of people's acceleration, m/s²."""
SPEED_ERROR = 0.15
"""Standard deviation of the speed a track is told with, along each axis, m/s."""
EDGE = 0.3
"""Metres inside a camera's view from which on it ought to see somebody."""
REACH = 3.0
"""Metres from a track beyond which no detection is its own."""
MOST_SIGMAS = 5.0
"""What is farther off than predicted says no more against a track."""
DETECTED = (0.05, 0.98)
"""p_d is within these …"""
LEAST_CLUTTER = 1e-4
"""… and clutter at least this many detections per m² and look."""
APART = 1e4
"""Metres between the floors of two cameras, so that one search tree holds all of them."""


@dataclass
class _Camera:
    """What was counted of a camera: seconds of looks, of tracks in view and of those seen, clutter, innovations."""

    area: float
    waiting: deque[DetectionFrame] = field(default_factory=lambda: deque(maxlen=WAITING))
    last: float = -math.inf
    looks: float = 1.0
    inside: float = 5.0
    seen: float = 4.0
    clutter: float = 0.2
    innovations: float = 50.0
    squares: float = 50.0

    def fade(self, kept: float) -> None:
        self.looks *= kept
        self.inside *= kept
        self.seen *= kept
        self.clutter *= kept
        self.innovations *= kept
        self.squares *= kept

    @property
    def detected(self) -> float:
        return min(max(self.seen / max(self.inside, 1e-9), DETECTED[0]), DETECTED[1])

    @property
    def density(self) -> float:
        """Clutter per m² and look."""
        return max(self.clutter / max(self.looks, 1e-9) / self.area, LEAST_CLUTTER)

    @property
    def scale(self) -> float:
        """By how much innovations' squares are larger than said."""
        return self.squares / max(self.innovations, 1e-9)


@dataclass(frozen=True)
class _Before:
    """The tracks of the frame before: (n,) ascending ids, places, velocities, variances."""

    t: float
    track: Integers
    place: Array
    velocity: Array
    covariance: Array


class SightScore:
    """Scores the tracks of one area; feed it detection and track frames in the order in which the bus brings them.

    Args:
        views: what each camera of the area sees (``shared.site.camera_views``).
    """

    def __init__(self, views: Mapping[str, ViewMap]) -> None:
        self._views = dict(views)
        self._cameras = {
            name: _Camera(max(float((view.depth > 0.0).sum()) * view.cell**2, 1.0)) for name, view in views.items()
        }
        self._before: _Before | None = None

    def take_detections(self, frame: DetectionFrame) -> None:
        """Take in what a camera of the area saw; other cameras' frames are left out."""
        camera = self._cameras.get(frame.camera)
        if camera is not None:
            camera.waiting.append(frame)

    def score(self, frame: TrackFrame) -> dict[int, float]:
        """Return the nats by which cameras spoke for each track since the frame scored before, by track id."""
        if self._before is not None and 0.0 < frame.t - self._before.t < LOOK - SAME:
            return {}
        columns = np.concatenate([np.array([frame.x, frame.y, frame.vx, frame.vy], float), _rows(frame).T])
        track = np.array(frame.track, np.int64)
        followed = np.array([state != "unseen" for state in frame.state], np.bool_)
        order = np.flatnonzero(followed)
        order = order[np.argsort(track[order], kind="stable")]
        columns = columns[:, order]
        now = _Before(frame.t, track[order], columns[:2].T, columns[2:4].T, columns[4:])
        before, self._before = self._before, now
        if before is not None and not 0.0 < frame.t - before.t < 10.0 * CYCLE:
            before = None  # a clock set back, or a long silence
        gain = np.zeros(len(order))
        looked = self._due(frame.t)
        if looked:
            self._score(now, before, [frame.sources[row] for row in order.tolist()], looked, gain)
        return dict(zip(now.track.tolist(), gain.tolist(), strict=True))

    def detected(self) -> dict[str, float]:
        """Return by camera the share of the people in its view whom it sees, p_d."""
        return {name: camera.detected for name, camera in self._cameras.items()}

    def clutter(self) -> dict[str, float]:
        """Return by camera the detections of nobody per m² and frame."""
        return {name: camera.density for name, camera in self._cameras.items()}

    def _due(self, t: float) -> list[tuple[str, DetectionFrame, float]]:
        """Return each camera's newest frame that tracks of time ``t`` have taken in, and the seconds it stands for."""
        due: list[tuple[str, DetectionFrame, float]] = []
        for name, camera in self._cameras.items():
            if camera.waiting and camera.waiting[0].t > t + 10.0 * CYCLE:
                camera.waiting.clear()
            newest = None
            while camera.waiting and camera.waiting[0].t <= t + SAME:
                newest = camera.waiting.popleft()
            if newest is None:
                continue
            stands = newest.t - camera.last
            camera.last = newest.t
            stands = min(stands, CYCLE) if stands > 0.0 else 0.0
            camera.fade(math.exp(-stands / MEMORY))
            if stands > 0.0:
                due.append((name, newest, stands))
        return due

    def _score(
        self,
        now: _Before,
        before: _Before | None,
        sources: list[list[str]],
        looked: list[tuple[str, DetectionFrame, float]],
        gain: Array,
    ) -> None:
        number = {name: index for index, (name, _, _) in enumerate(looked)}
        pairs = [(row, number[name]) for row, names in enumerate(sources) for name in names if name in number]
        rows, which = np.array(pairs, np.int64).reshape(-1, 2).T
        detections = _gathered(looked)
        used = self._assigned(now, before, rows, which, detections, looked, gain)
        fed = np.zeros((len(looked), len(gain)), np.bool_)
        fed[which, rows] = True
        for index, (name, frame, stands) in enumerate(looked):
            camera = self._cameras[name]
            missed = ~fed[index] & (self._views[name].depth_at(now.place) > EDGE)
            gain[missed] += stands / CYCLE * missed_nats(camera.detected)
            seen = float(np.count_nonzero(fed[index]))
            camera.looks += stands
            camera.seen += stands * seen
            camera.inside += stands * (seen + float(np.count_nonzero(missed)))
            camera.clutter += stands * max(len(frame.x) - used[index], 0)

    def _assigned(
        self,
        now: _Before,
        before: _Before | None,
        rows: Integers,
        which: Integers,
        detections: Array,
        looked: list[tuple[str, DetectionFrame, float]],
        gain: Array,
    ) -> list[int]:
        """Add the nats of the detections that fed tracks; return how many of each camera's did."""
        if not len(rows) or not len(detections):
            return [0] * len(looked)
        tree = cKDTree(np.column_stack([detections[:, :2], APART * detections[:, 5]]))
        found = tree.query(np.column_stack([now.place[rows], APART * which]), distance_upper_bound=REACH)
        near, nearest = np.isfinite(found[0]), np.asarray(found[1], np.int64)
        rows, which, nearest = rows[near], which[near], nearest[near]
        first = np.unique(nearest, return_index=True)[1]
        used: list[int] = np.bincount(which[first], minlength=len(looked)).tolist()
        if before is None or not len(before.track):
            return used
        at = np.minimum(np.searchsorted(before.track, now.track[rows]), len(before.track) - 1)
        known = before.track[at] == now.track[rows]
        rows, which, nearest, at = rows[known], which[known], nearest[known], at[known]
        detection = detections[nearest]
        # The detection may be older than the tracks' time, by a chunk or by the camera's lateness.
        dt = np.maximum(detection[:, 6] - before.t, 0.0)
        innovation = detection[:, :2] - before.place[at] - before.velocity[at] * dt[:, None]
        spread = (SPEED_ERROR * dt) ** 2 + (0.5 * ACCELERATION * dt**2) ** 2
        scale = np.array([self._cameras[name].scale for name, _, _ in looked])[which]
        xx, xy, yy = (before.covariance[:, at] + detection[:, 2:5].T) * scale
        xx, yy = xx + spread, yy + spread
        squared, log_determinant = off_by(innovation[:, 0], innovation[:, 1], xx, xy, yy)
        believed = np.minimum(squared, MOST_SIGMAS**2)
        seconds = np.array([stands for _, _, stands in looked])
        detected = np.array([self._cameras[name].detected for name, _, _ in looked])
        clutter = np.array([self._cameras[name].density for name, _, _ in looked])
        nats = assigned_nats(believed, log_determinant, detected[which], clutter[which])
        np.add.at(gain, rows, seconds[which] / CYCLE * nats)
        for index, (name, _, stands) in enumerate(looked):
            mine = which == index
            camera = self._cameras[name]
            camera.innovations += stands * float(np.count_nonzero(mine))
            camera.squares += stands * float((believed * scale)[mine].sum()) / 2.0
        return used


def _rows(frame: TrackFrame | DetectionFrame) -> Array:
    """Return the covariances (n, 3) of a frame: xx, xy, yy in columns."""
    return np.fromiter(chain.from_iterable(frame.covariance), np.float64, 3 * len(frame.covariance)).reshape(-1, 3)


def _gathered(looked: list[tuple[str, DetectionFrame, float]]) -> Array:
    """Return (n, 7) detections of all cameras: x, y, xx, xy, yy, number of the camera, time."""
    parts = [
        np.column_stack([frame.x, frame.y, _rows(frame), np.full((len(frame.x), 2), (index, frame.t))])
        for index, (_, frame, _) in enumerate(looked)
        if frame.x
    ]
    return np.concatenate(parts) if parts else np.zeros((0, 7))
