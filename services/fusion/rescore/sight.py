"""How well do cameras' detections support the tracks? The cumulative quality score [ravel-thesis §8.1/8.2, Eq. 5.1].

Each camera frame is held against where the tracks of the chunk *before* were going, by the terms of
``shared.sight_nats``; clutter is one detection, uniform over the floor the camera sees. A detector that fires seldom
pays for misses; one that fires anywhere gains nothing, because what is no track's counts for nobody, and tracks made of
it do not last. The score is the sum over tracks of high quality: those that lasted and whose own sum speaks for them.

Learning scores tracks by the same terms (``services/learning/tracks/sight.py``) but counts p_d and clutter as it goes,
takes the tracker's word for which detection was whose, and weighs a look by its time. Here two detectors are compared
on the same pictures: counted from its own detections, each would be held to its own standard, and one that sees ghosts
would be forgiven them.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from services.fusion.area_view import AreaView
from services.fusion.rescore.significance import SLOT
from shared.messages import DetectionFrame, TrackFrame, covariances, positions
from shared.sight_nats import assigned_nats, missed_nats, off_by

__all__ = ["Sight", "SightJudge"]

Array = NDArray[np.float64]

DETECTION = 0.9
"""Probability that somebody in view is detected in a frame."""
WANDER = 0.7
"""m/s by which a walk may differ from the velocity told."""
LONGEST = 1.0
"""Seconds over which a track is predicted."""
GATE = 13.8
"""Squared standard deviations beyond which nothing is assigned: 0.1 % of two-dimensional normal ones."""
LASTING = 5.0
"""Seconds for which a track must have been looked at to be of high quality."""


@dataclass(frozen=True)
class Sight:
    """Sums over the tracks of high quality.

    Attributes:
        tracks: how many.
        lasted: seconds they were looked at, together.
        quality: nats.
        slots: nats by block of ``SLOT`` seconds.
    """

    tracks: int
    lasted: float
    quality: float
    slots: dict[int, float]


class SightJudge:
    """Scores the tracks of one run.

    Args:
        view: the area.
        since: seconds since the epoch; frames from then on …
        until: … and before this time count.
    """

    def __init__(self, view: AreaView, since: float, until: float) -> None:
        self._view, self._since, self._until = view, since, until
        self._clutter = {
            camera: 1.0 / max(float((seen.depth > 0.0).sum()) * seen.cell**2, 1.0)
            for camera, seen in view.views.items()
        }
        self._sums: dict[int, dict[int, float]] = defaultdict(lambda: defaultdict(float))
        self._looked: dict[int, tuple[float, float]] = {}

    def look(self, frames: Sequence[DetectionFrame], before: TrackFrame) -> None:
        """Hold what cameras saw in one chunk against the tracks of the chunk before."""
        followed = [row for row, state in enumerate(before.state) if state != "unseen"]
        wanted = [one for one in frames if self._since <= one.t < self._until and one.camera in self._clutter]
        if not followed or not wanted:
            return
        place, spread = positions(before)[followed], covariances(before)[followed]
        pace = np.column_stack([before.vx, before.vy])[followed]
        ids = np.array(before.track)[followed]
        for frame in wanted:
            elapsed = min(max(frame.t - before.t, 0.0), LONGEST)
            ahead = place + elapsed * pace
            inside = np.flatnonzero(self._view.views[frame.camera].depth_at(ahead) > 0.0)
            wide = spread[inside] + np.eye(2) * (WANDER * elapsed) ** 2
            gain = self._gain(frame, ahead[inside], wide)
            for track, nats in zip(ids[inside].tolist(), gain.tolist(), strict=True):
                self._sums[track][math.floor(frame.t / SLOT)] += nats
                self._looked[track] = self._looked.get(track, (frame.t, 0.0))[0], frame.t

    def sight(self) -> Sight:
        """Return the score."""
        slots: dict[int, float] = defaultdict(float)
        tracks, lasted = 0, 0.0
        for track, sums in self._sums.items():
            first, last = self._looked[track]
            if last - first < LASTING or sum(sums.values()) <= 0.0:
                continue
            tracks, lasted = tracks + 1, lasted + last - first
            for slot, nats in sums.items():
                slots[slot] += nats
        return Sight(tracks, lasted, sum(slots.values()), dict(slots))

    def _gain(self, frame: DetectionFrame, place: Array, spread: Array) -> Array:
        """Return (k,) nats by which a frame speaks for the tracks at (k, 2) places in its view."""
        missed = missed_nats(DETECTION)
        gain = np.full(len(place), missed)
        if not len(frame.x) or not len(place):
            return gain
        apart = positions(frame)[None] - place[:, None]
        both = spread[:, None] + covariances(frame)[None]
        off, log_determinant = off_by(apart[..., 0], apart[..., 1], both[..., 0, 0], both[..., 0, 1], both[..., 1, 1])
        ratio = assigned_nats(off, log_determinant, DETECTION, self._clutter[frame.camera])
        worth = np.where((off < GATE) & (ratio > missed), ratio - missed, 0.0)
        rows, columns = linear_sum_assignment(worth, maximize=True)
        gain[rows] += worth[rows, columns]
        return gain
