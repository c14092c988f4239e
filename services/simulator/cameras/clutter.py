"""What does a detector see where nobody is? Flickers anywhere, and reflections and shadows that come back and stay."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from shared.site import CameraGeometry, Floor

__all__ = ["Clutter"]

Array = NDArray[np.float64]

_GRID = 6
"""Pixels between the places where a flicker may stand."""
_BLINK = 0.8
"""Share of its frames in which a reflection is found."""
_WOBBLE = 0.12
"""Metres by which a reflection comes back elsewhere."""


class Clutter:
    """False detections of one camera: (frame, place) pairs.

    Args:
        geometry: of the camera.
        floor: which is seen.
        interest: where feet are looked for, pixels; None: in the whole picture.
        per_frame: flickers in a frame, mean.
        places: how many places reflect now and then.
        episodes_per_s: how often one of them does.
        seconds: mean duration.
        interval: seconds between frames.
        rng: its own generator.
    """

    def __init__(
        self,
        geometry: CameraGeometry,
        floor: Floor,
        interest: shapely.Polygon | None,
        per_frame: float,
        places: int,
        episodes_per_s: float,
        seconds: float,
        interval: float,
        rng: np.random.Generator,
    ) -> None:
        width, height = geometry.image_size
        u, v = np.meshgrid(np.arange(_GRID / 2, width, _GRID), np.arange(_GRID / 2, height, _GRID))
        pixels = np.column_stack([u.ravel(), v.ravel()])
        ground = geometry.to_ground(pixels)
        seen = np.isfinite(ground[:, 0])
        outline = shapely.Polygon(floor.outline)
        seen[seen] &= shapely.contains_xy(outline, ground[seen, 0], ground[seen, 1])
        if interest is not None:
            seen &= shapely.contains_xy(interest, pixels[:, 0], pixels[:, 1])
        self._ground = ground[seen]
        self._per_frame = per_frame if len(self._ground) else 0.0
        self._episodes_per_s = episodes_per_s if places and len(self._ground) else 0.0
        self._seconds = seconds
        self._interval = interval
        self._rng = rng
        self._places = self._anywhere(places) if len(self._ground) else np.zeros((0, 2))
        self._running: list[tuple[float, float, Array]] = []

    def next(self, start: float, count: int) -> tuple[NDArray[np.int64], Array]:
        """Return the frames (m,), counted from 0, and places (m, 2), metres, of ``count`` frames from ``start`` on."""
        numbers = self._rng.poisson(self._per_frame, count)
        frames = [np.repeat(np.arange(count), numbers)]
        places = [self._anywhere(int(numbers.sum()))]
        span = count * self._interval
        for _ in range(int(self._rng.poisson(self._episodes_per_s * span))):
            begin = start + float(self._rng.uniform(0.0, span))
            place = self._places[int(self._rng.integers(len(self._places)))] + self._rng.normal(0.0, _WOBBLE, 2)
            self._running.append((begin, begin + float(self._rng.exponential(self._seconds)), place))
        times = start + self._interval * np.arange(count)
        for begin, end, place in self._running:
            shown = np.flatnonzero((times >= begin) & (times < end) & (self._rng.random(count) < _BLINK))
            frames.append(shown)
            places.append(place + self._rng.normal(0.0, 0.03, (len(shown), 2)))
        self._running = [episode for episode in self._running if episode[1] > start + span]
        return np.concatenate(frames), np.concatenate(places)

    def _anywhere(self, count: int) -> Array:
        if not count:
            return np.zeros((0, 2))
        return self._ground[self._rng.integers(len(self._ground), size=count)] + self._rng.uniform(
            -0.05, 0.05, (count, 2)
        )
