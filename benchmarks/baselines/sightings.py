"""Which detections were made in which frame? Detection frames as flat columns, for what runs over whole recordings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from shared.messages import DetectionFrame

__all__ = ["Sightings"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Sightings:
    """The detections of n frames, in the order of time; frame i holds the rows ``start[i]:start[i + 1]``.

    Attributes:
        t: (n,) seconds; several cameras of one area may share a time.
        camera: (n,) which camera, numbered in the order of first appearance.
        start: (n + 1,) where each frame's rows begin.
        position: (d, 2), metres.
        noise: (d, 2, 2), m².
    """

    t: Array
    camera: NDArray[np.int64]
    start: NDArray[np.int64]
    position: Array
    noise: Array

    @classmethod
    def of(cls, frames: Sequence[DetectionFrame]) -> Sightings:
        """Return the frames as columns, sorted by time."""
        frames = sorted(frames, key=lambda frame: frame.t)
        number = {camera: place for place, camera in enumerate(dict.fromkeys(frame.camera for frame in frames))}
        x, y = (_flat(getattr(frame, axis) for frame in frames) for axis in "xy")
        covariance = _flat(chain.from_iterable(frame.covariance for frame in frames)).reshape(-1, 3)
        return cls(
            t=np.array([frame.t for frame in frames], float),
            camera=np.array([number[frame.camera] for frame in frames], np.int64),
            start=np.concatenate([[0], np.cumsum([len(frame.x) for frame in frames], dtype=np.int64)]),
            position=np.column_stack([x, y]),
            noise=covariance[:, [0, 1, 1, 2]].reshape(-1, 2, 2),
        )

    def rows(self, frames: Iterable[int]) -> NDArray[np.int64]:
        """Return the rows of the detections of some frames, in their order."""
        pieces = [np.arange(self.start[frame], self.start[frame + 1]) for frame in frames]
        return np.concatenate(pieces) if pieces else np.zeros(0, np.int64)

    def thinned(self, frames_per_s: float) -> Sightings:
        """Return every so many frames of each camera, such that none has more than ``frames_per_s``.

        Raises:
            ValueError: ``frames_per_s`` is not positive.
        """
        if not frames_per_s > 0.0:
            raise ValueError(f"frames_per_s: {frames_per_s} is not allowed; it must be positive")
        keep = np.zeros(len(self.t), bool)
        for camera in np.unique(self.camera):
            of_camera = np.flatnonzero(self.camera == camera)
            # The thousandth of a frame keeps a camera of exactly this rate whole in spite of rounding.
            slot = np.floor((self.t[of_camera] - self.t[of_camera[0]]) * frames_per_s + 1e-3)
            keep[of_camera[np.diff(slot, prepend=-1.0) > 0.0]] = True
        kept = np.flatnonzero(keep)
        rows = self.rows(kept.tolist())
        return Sightings(
            t=self.t[kept],
            camera=self.camera[kept],
            start=np.concatenate([[0], np.cumsum(np.diff(self.start)[kept])]),
            position=self.position[rows],
            noise=self.noise[rows],
        )


def _flat(columns: Iterable[Sequence[float]]) -> Array:
    return np.fromiter(chain.from_iterable(columns), float)
