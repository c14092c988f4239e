"""Was a camera turned that nobody else looks over the shoulder of? Phones know which way is north.

Where a camera pans, every track it feeds turns with it against the headings of the phones on them, all phones by the
same angle; where it tilts, tracks get longer or shorter than steps. One phone's headings are off by ten degrees from
walk to walk: so it takes a dozen walks to notice ten degrees, and they say *that*, not where to.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.learning.tracks.stretch import Stretch
from services.learning.walking.runs import runs_of
from shared.messages import DetectionFrame

__all__ = ["TurnedViews"]

Array = NDArray[np.float64]

BEFORE, NOW = 40, 14
"""Walks: how many a camera's usual turn is taken from, and how many are held against it."""
LEAST_BEFORE = 12
LEAST_OWN = 3
"""Walks of a phone before, from which its own usual turn is known."""
WALK_SIGMA = (math.radians(10.0), 0.08)
"""Of a walk's turn, radians, and of the length of its steps, as a share, against others of the same phone."""
SURE = 4.0
"""Standard errors: a change is looked for at every walk."""
LEAST = (math.radians(6.0), 0.08)
FLIPPED = math.radians(75.0)
MEMORY = 90.0
"""Seconds for which it is known which cameras see anybody."""
NEAR = 0.8
"""Metres."""
EVERY = 1.0
MOST_DEVICES = 1000


@dataclass(frozen=True)
class _Walk:
    t: float
    device: str
    said: tuple[float, float]
    """Turn, radians, and the logarithm of how much longer steps were seen than published."""


class TurnedViews:
    """Watches by phones which way the cameras of an area look."""

    def __init__(self) -> None:
        self._frames: dict[str, deque[tuple[float, Array]]] = {}
        self._walks: dict[str, deque[_Walk]] = {}

    def take_frame(self, frame: DetectionFrame) -> None:
        """Take in what a camera saw, in order of time."""
        kept = self._frames.setdefault(frame.camera, deque())
        if kept and frame.t < kept[-1][0] - MEMORY:
            kept.clear()
        if kept and frame.t < kept[-1][0] + EVERY:
            return
        kept.append((frame.t, np.column_stack([frame.x, frame.y]).reshape(-1, 2)))
        while kept[0][0] < frame.t - MEMORY:
            kept.popleft()

    def learn(self, stretch: Stretch) -> None:
        """Take in a stretch that one camera alone saw, soon after it was closed."""
        runs = runs_of(stretch)
        straight = np.isfinite(runs.turned) & (np.abs(runs.turned) < FLIPPED)
        camera = self._camera(stretch)
        if camera is None or not straight.any():
            return
        turn = float(np.angle(np.exp(1j * runs.turned[straight]).mean()))
        longer = float(np.log(runs.way[straight] / runs.length[straight]).mean())
        walks = self._walks.setdefault(camera, deque(maxlen=BEFORE + NOW))
        walks.append(_Walk(float(stretch.t[-1]), stretch.device, (turn, longer)))

    def forget(self, device: str) -> None:
        """Forget a device."""
        for camera, walks in self._walks.items():
            self._walks[camera] = deque((walk for walk in walks if walk.device != device), maxlen=BEFORE + NOW)

    def restart(self, camera: str) -> None:
        """Begin anew: the camera's positions have been corrected."""
        self._walks.pop(camera, None)

    def words(self, camera: str) -> str:
        """Return what phones say against a camera; empty where nothing."""
        walks = self._walks.get(camera, ())
        if len(walks) < LEAST_BEFORE + NOW:
            return ""
        table = np.array([walk.said for walk in walks])
        count = len(table) - NOW
        device = np.array([walk.device for walk in walks])
        for name in np.unique(device):
            own = device == name
            if own[:count].sum() >= LEAST_OWN:
                table[own] -= np.median(table[:count][own[:count]], axis=0)
        change = np.median(table[-NOW:], axis=0) - np.median(table[:count], axis=0)
        error = 1.25 * np.array(WALK_SIGMA) * math.sqrt(1.0 / NOW + 1.0 / count)  # of a difference of medians
        if abs(change[0]) > max(LEAST[0], SURE * error[0]):
            by = f"{abs(math.degrees(change[0])):.0f}°"
            return f"phones say that what camera {camera} sees has turned by about {by}: was it knocked?"
        if abs(change[1]) > max(LEAST[1], SURE * error[1]):
            by = f"{abs(math.expm1(change[1])) * 100.0:.0f} % {'longer' if change[1] > 0.0 else 'shorter'}"
            return f"phones say that ways camera {camera} sees are {by} than before: was it knocked?"
        return ""

    def _camera(self, stretch: Stretch) -> str | None:
        """Return the one camera that saw it."""
        cameras = [camera for camera, frames in self._frames.items() if _saw(stretch, frames)]
        return cameras[0] if len(cameras) == 1 else None


def _saw(stretch: Stretch, frames: deque[tuple[float, Array]]) -> bool:
    seen = total = 0
    for t, found in frames:
        if stretch.t[0] <= t <= stretch.t[-1]:
            total += 1
            where = np.array([np.interp(t, stretch.t, stretch.place[:, axis]) for axis in (0, 1)])
            seen += bool(len(found) and np.hypot(*(found - where).T).min() < NEAR)
    return total > 0 and seen > 0.3 * total
