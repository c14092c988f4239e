"""Is a camera's clock right? Its people set off and stop when phones' steps begin and end, or earlier, or later.

Phones' clocks are known to a few hundredths of a second. So the speed at which a camera's detections move is held
against the speed of the steps of the phone that was on that track, at every lag of two seconds either way. A steady
walk says nothing, starts and stops say it all; sums over phones and minutes say it well. Detections, not tracks: what a
filter makes of them comes after them.
"""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.learning.tracks.stretch import Stretch
from shared.messages import DetectionFrame, MotionBatch

__all__ = ["ClockReading", "StepClock"]

Array = NDArray[np.float64]

LAGS: Array = np.round(np.arange(-2.0, 2.001, 0.1), 3)
"""Seconds."""
MEMORY = 90.0
"""Seconds of detections kept: a stretch of a minute is told a quarter of a minute after its end."""
EVERY = 0.19
"""Seconds between two kept frames of a camera."""
NEAR = 0.8
"""Metres from its track within which a detection is the track's, if it is alone there."""
GRID = 0.1
"""Seconds."""
WINDOW = 1.0
"""Seconds either way over which a speed is taken."""
LONGEST_STEP = 0.8
"""Seconds; after a longer pause a step took so long."""
LEAST_SECONDS = 5.0
LEAST_SPREAD = 0.15
"""m/s by which somebody's speed must vary to say anything."""
LEAST_SHARE = 0.4
"""Of the variance of somebody's speed that the steps explain at the best lag; else it was somebody else."""
MOST_SAID = 30.0
"""By which any lag of one stretch is worse than its best: no stretch decides alone."""
MOST_STRETCHES = 120
LEAST_STRETCHES = 5
EARLY, EARLY_SIGMA = 0.22, 0.1
"""Seconds by which steps seem to come before the body: a walk begins and ends in the middle of one, and footfalls are
told a little early (0.10 s on recordings). On ten cameras of the twin it was 0.13 to 0.31; no more is known."""
WRONG = 0.2
"""Seconds by which a clock may be off before anybody is told."""


@dataclass(frozen=True)
class ClockReading:
    """What the phones say of a camera's clock.

    Attributes:
        offset: seconds by which its pictures are later than phones' steps say; negative: earlier. None: not known.
        error: standard deviation of that.
        words: for an operator; empty where nothing is wrong.
    """

    offset: float | None = None
    error: float | None = None
    words: str = ""


class StepClock:
    """Reads the clocks of an area's cameras from its phones' steps."""

    def __init__(self) -> None:
        self._frames: dict[str, deque[tuple[float, Array]]] = {}
        self._steps: dict[str, list[tuple[float, float]]] = {}
        self._curves: dict[str, deque[Array]] = {}

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

    def take_motion(self, batch: MotionBatch) -> None:
        """Take in a phone's steps, also those before and after its stretches: a lag moves them in and out."""
        steps = self._steps.pop(batch.device, [])
        if batch.revises_from is not None:
            del steps[bisect_left(steps, (batch.revises_from,)) :]
        for row in zip(batch.step_t, batch.length, strict=True):
            insort(steps, row)
        del steps[: bisect_left(steps, (batch.t - MEMORY,))]
        if steps:
            self._steps[batch.device] = steps
        # Who left tells nothing any more; the longest silent ones stand first.
        while self._steps and next(iter(self._steps.values()))[-1][0] < batch.t - MEMORY:
            del self._steps[next(iter(self._steps))]

    def forget(self, device: str) -> None:
        """Forget a device's steps; sums over many people stay."""
        self._steps.pop(device, None)

    def learn(self, stretch: Stretch) -> None:
        """Take in a stretch, soon after it was closed."""
        steps = np.array(self._steps.get(stretch.device, []), float).reshape(-1, 2)
        for camera, frames in self._frames.items():
            t, place = _sightings(stretch, frames)
            curve = _curve(t, place, steps[:, 0], steps[:, 1])
            if curve is not None:
                self._curves.setdefault(camera, deque(maxlen=MOST_STRETCHES)).append(curve)

    def reading(self, camera: str) -> ClockReading:
        """Return what is known of a camera's clock by now."""
        curves = self._curves.get(camera, ())
        if len(curves) < LEAST_STRETCHES:
            return ClockReading()
        table = np.array(curves)
        total = table.sum(axis=0)
        offset = _lowest(total) - EARLY
        left_out = np.array([_lowest(total - curve) for curve in table])
        count = len(table)
        scatter = (count - 1) / count * float(np.sum((left_out - left_out.mean()) ** 2))
        error = math.sqrt(scatter + EARLY_SIGMA**2)
        words = ""
        if abs(offset) > WRONG and abs(offset) > 2.0 * error:
            later, change = ("later", "raise") if offset > 0.0 else ("earlier", "lower")
            words = (
                f"pictures of camera {camera} are stamped {abs(offset):.1f} s {later} than phones' steps say: is its "
                f"clock right? If so, {change} its latency in the site file by that much"
            )
        return ClockReading(offset, error, words)


def _sightings(stretch: Stretch, frames: deque[tuple[float, Array]]) -> tuple[Array, Array]:
    """Return times (n,) and places (n, 2) of the one detection near the track in each frame."""
    inside = [(at, found) for at, found in frames if stretch.t[0] <= at <= stretch.t[-1] and len(found)]
    times = np.array([at for at, _ in inside])
    where = np.column_stack([np.interp(times, stretch.t, stretch.place[:, axis]) for axis in (0, 1)])
    rows: list[tuple[float, Array]] = []
    for (at, found), spot in zip(inside, where, strict=True):
        near = np.flatnonzero(((found - spot) ** 2).sum(axis=1) < NEAR**2)
        if len(near) == 1:
            rows.append((at, found[near[0]]))
    return np.array([at for at, _ in rows]), np.array([spot for _, spot in rows]).reshape(-1, 2)


def _curve(t: Array, place: Array, step_t: Array, length: Array) -> Array | None:
    """Return how badly steps told at each lag explain the speed of detections (lags,); None where it says nothing."""
    if len(t) < 10 or not len(step_t):
        return None
    grid = np.arange(t[0], t[-1], GRID)
    speed = _speed(t, place, grid)
    known = np.isfinite(speed)
    if known.sum() * GRID < LEAST_SECONDS or speed[known].std() < LEAST_SPREAD:
        return None
    reach = float(LAGS[-1])
    wide = np.arange(t[0] - reach, t[-1] + reach, GRID)
    steps = _step_speed(step_t, length, wide)
    costs = np.empty(len(LAGS))
    for row, lag in enumerate(LAGS):
        x = np.interp(grid[known] - lag, wide, steps)
        x = np.column_stack([x, np.ones(len(x))])
        share, *_ = np.linalg.lstsq(x, speed[known], rcond=None)
        costs[row] = float(np.sum((speed[known] - x @ np.array([max(share[0], 0.0), share[1]])) ** 2))
    if costs.min() > (1.0 - LEAST_SHARE) * known.sum() * speed[known].var():
        return None
    scale = costs.min() / (known.sum() * GRID)
    curve: Array = np.minimum((costs - costs.min()) / max(scale, 0.01), MOST_SAID)
    return curve


def _speed(t: Array, place: Array, at: Array) -> Array:
    """Return the speed (m,) at times ``at``, of the straight line through the detections about each; NaN where few."""
    speed = np.full(len(at), np.nan)
    for row, now in enumerate(at):
        first, after = np.searchsorted(t, [now - WINDOW, now + WINDOW])
        if after - first < 4 or t[after - 1] - t[first] < 1.2 * WINDOW:
            continue
        since = t[first:after] - t[first:after].mean()
        speed[row] = np.hypot(*(since @ place[first:after])) / float(since @ since)
    return speed


def _step_speed(step_t: Array, length: Array, at: Array) -> Array:
    """Return the speed (m,) of steps as ``_speed`` would see it: even within a step, taken over the same window."""
    began = np.maximum(np.concatenate([[-np.inf], step_t[:-1]]), step_t - LONGEST_STEP)
    edges = np.ravel(np.column_stack([began, step_t]))
    walked = np.ravel(np.column_stack([np.cumsum(length) - length, np.cumsum(length)]))
    share = np.linspace(-1.0, 1.0, 13)
    way = np.interp(at[:, None] + WINDOW * share, edges, walked)
    speed: Array = way @ share / (WINDOW * float(share @ share))
    return speed


def _lowest(curve: Array) -> float:
    """Return the lag of the lowest point, of the parabola through it and its neighbours."""
    row = int(np.clip(np.argmin(curve), 1, len(curve) - 2))
    before, here, after = curve[row - 1 : row + 2]
    bend = before - 2.0 * here + after
    return float(LAGS[row] + (0.5 * (before - after) / bend * (LAGS[1] - LAGS[0]) if bend > 0.0 else 0.0))
