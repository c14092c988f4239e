"""How much does a phone's walk say about which track carries it? Speeds, turns and pauses, against a stranger's walk.

If the device is on a track, its steps add up to the track's displacement and its headings follow the track's direction
but for a bias of the phone (its compass, how it is carried) that hardly changes. If it is elsewhere, its next second is
like its last. So a person who walks straight on says little, a person who turns, stops or starts says much, and what
two people who do the same have in common counts for neither. A stranger is never predicted more sharply than the person
on the right track could be: whoever knows the track knows the past as well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

__all__ = ["Walk", "WalkFilters", "walks_of"]

Array = NDArray[np.float64]

MOVING = 0.4
"""Metres per second below which a direction means nothing."""
LENGTH_ERROR = (0.2, 0.25)
"""Standard deviation of a second's walk by steps: metres, and share of its length."""
TRACK_ERROR = 0.2
"""Metres; of a track's displacement, across its direction."""
HEADING_ERROR = math.radians(12.0)
BIAS = math.radians(15.0)
"""Standard deviation of a phone's heading bias before anything is known; it wanders by ``BIAS_WALK`` per √s."""
BIAS_WALK = math.radians(3.0)
STRANGER_TURN = math.radians(15.0)
STRANGER_SPEED = 0.25
"""How a stranger's direction and speed (m/s) wander in a second, most of the time …"""
STRANGER_CHANGES = 0.2
"""… and how often they change at random."""
OUTLIER = 0.05
"""Share of seconds in which a phone's walk is simply wrong."""
LIMIT = 4.0
"""No second says more than this, in nats."""
UNKNOWN_HEADING = 2.0
"""rad²; a heading with more variance is none."""


@dataclass(frozen=True, slots=True)
class Walk:
    """One stretch of a phone's dead reckoning, about a second.

    Attributes:
        t_start, t: its time.
        length: metres walked.
        heading: mean direction, radians; NaN where there is none.
        heading_variance: rad².
    """

    t_start: float
    t: float
    length: float
    heading: float
    heading_variance: float


def walks_of(
    t_start: float, t: float, step_t: list[float], length: list[float], heading: list[float], variance: list[float]
) -> list[Walk]:
    """Cut a motion batch into stretches of about a second; a batch shorter than half a second gives none."""
    duration = t - t_start
    if not 0.5 <= duration <= 10.0:
        return []
    pieces = max(1, round(duration))
    edges = np.linspace(t_start, t, pieces + 1)
    when, metres = np.asarray(step_t, float), np.asarray(length, float)
    direction, spread = np.asarray(heading, float), np.asarray(variance, float)
    usable = np.isfinite(when) & np.isfinite(metres) & (metres >= 0.0) & (metres < 3.0)
    walks = []
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        mine = usable & (when > begin) & (when <= end)
        known = mine & np.isfinite(direction) & (spread < UNKNOWN_HEADING) & (spread >= 0.0)
        total = float(metres[mine].sum())
        towards, uncertainty = math.nan, math.inf
        if known.any() and total > MOVING * (end - begin):
            east = float((metres[known] * np.cos(direction[known])).sum())
            north = float((metres[known] * np.sin(direction[known])).sum())
            towards, uncertainty = math.atan2(north, east), float(spread[known].mean())
        walks.append(Walk(begin, end, total, towards, uncertainty))
    return walks


@dataclass
class WalkFilters:
    """What is known of d devices' walks under k hypotheses.

    Attributes:
        bias, bias_variance: (d, k), of the heading if the device is on that track, rad and rad².
        last: (d, 3), the device's stretch before: its end, its speed (m/s), its heading (NaN for none).
    """

    bias: Array
    bias_variance: Array
    last: Array

    @classmethod
    def new(cls, devices: int, tracks: int) -> WalkFilters:
        """Return filters that have seen nothing."""
        return cls(np.zeros((devices, tracks)), np.full((devices, tracks), BIAS**2), np.full((devices, 3), np.nan))

    def walk(self, device: int, rows: NDArray[np.int64], walk: Walk, displacement: Array) -> Array:
        """Return what one stretch says for each track, nats against a stranger, and learn from it.

        Args:
            device: whose walk.
            rows: (n,) the tracks.
            walk: the stretch.
            displacement: (n, 2), how far each track moved meanwhile, metres.
        """
        duration = walk.t - walk.t_start
        moved = np.hypot(displacement[:, 0], displacement[:, 1])
        sigma = LENGTH_ERROR[0] + LENGTH_ERROR[1] * moved
        for_track = _with_outliers(_normal(walk.length - moved, sigma**2), 0.5)
        before_t, before_speed, before_heading = self.last[device].tolist()
        fresh = not abs(walk.t_start - before_t) < 2.0
        against = _stranger_length(walk.length / duration, math.nan if fresh else before_speed) / duration
        evidence = np.log(for_track / against)
        if math.isfinite(walk.heading):
            evidence += self._turn(device, rows, walk, displacement, moved, math.nan if fresh else before_heading)
        self.last[device] = (walk.t, walk.length / duration, walk.heading)
        limited: Array = np.minimum(np.maximum(evidence, -LIMIT), LIMIT)
        return limited

    def _turn(
        self, device: int, rows: NDArray[np.int64], walk: Walk, displacement: Array, moved: Array, before: float
    ) -> Array:
        duration = walk.t - walk.t_start
        bias, variance = self.bias[device, rows], self.bias_variance[device, rows] + BIAS_WALK**2 * duration
        moving = moved > MOVING * duration
        direction = np.arctan2(displacement[:, 1], displacement[:, 0])
        error = HEADING_ERROR**2 + walk.heading_variance + (TRACK_ERROR / np.maximum(moved, 0.1)) ** 2
        surprise = _wrapped(walk.heading - direction - bias)
        spread = variance + error
        for_track = np.where(moving, _with_outliers(_normal(surprise, spread), 0.5 / math.pi), 0.5 / math.pi)
        gain = np.where(moving & (np.abs(surprise) < 3.0 * np.sqrt(spread)), variance / spread, 0.0)
        self.bias[device, rows] = bias + gain * surprise
        self.bias_variance[device, rows] = np.maximum(variance * (1.0 - gain), math.radians(2.0) ** 2)
        against = 0.5 / math.pi
        if math.isfinite(before):
            turn = _wrapped(np.array(walk.heading - before))
            floor = HEADING_ERROR**2 + walk.heading_variance + (TRACK_ERROR / max(walk.length, 0.1)) ** 2
            steady = float(_normal(turn, np.array(STRANGER_TURN**2 + floor)))
            against = (1.0 - STRANGER_CHANGES) * steady + STRANGER_CHANGES * against
        result: Array = np.log(for_track / against)
        return result

    def inherit(self, device: int, row: int, parent: int) -> None:
        """Let one hypothesis go on from what another knew."""
        self.bias[device, row] = self.bias[device, parent]
        self.bias_variance[device, row] = self.bias_variance[device, parent]

    def resize(self, devices: int, tracks: int) -> None:
        """Make room for more."""
        grown = WalkFilters.new(devices, tracks)
        rows, columns = self.bias.shape
        grown.bias[:rows, :columns], grown.bias_variance[:rows, :columns] = self.bias, self.bias_variance
        grown.last[:rows] = self.last
        for field in fields(self):
            setattr(self, field.name, getattr(grown, field.name))

    def reset_device(self, device: int) -> None:
        """Forget a device."""
        self.bias[device], self.bias_variance[device], self.last[device] = 0.0, BIAS**2, np.nan

    def reset_track(self, row: int) -> None:
        """Forget a track."""
        self.bias[:, row], self.bias_variance[:, row] = 0.0, BIAS**2


def _normal(error: Array, variance: Array) -> Array:
    density: Array = np.exp(-0.5 * error**2 / variance) / np.sqrt(2.0 * math.pi * variance)
    return density


def _with_outliers(density: Array, flat: float) -> Array:
    return (1.0 - OUTLIER) * density + OUTLIER * flat


def _wrapped(angle: Array) -> Array:
    wrapped: Array = (angle + math.pi) % (2.0 * math.pi) - math.pi
    return wrapped


def _stranger_length(speed: float, before: float) -> float:
    """Density, per m/s, of a stranger's speed: like the second before, or anything up to 2 m/s."""
    flat = 0.5
    if not math.isfinite(before):
        return flat
    sigma = math.hypot(STRANGER_SPEED, LENGTH_ERROR[0] + LENGTH_ERROR[1] * before)
    steady = math.exp(-0.5 * ((speed - before) / sigma) ** 2) / (sigma * math.sqrt(2.0 * math.pi))
    return (1.0 - STRANGER_CHANGES) * steady + STRANGER_CHANGES * flat
