"""How much does a phone's walk say about which track carries it? Speeds, turns and pauses, against a stranger's walk.

If the device is on a track, its steps add up to the track's displacement but for a stride scale, and its headings
follow the track's direction but for a bias of the walk (its compass, how it is carried); both are learned per
hypothesis, which marginalises them. If it is elsewhere, its next second is like its last. So a person who walks
straight on says little, a person who turns, stops or starts says much, and what two people who do the same have in
common counts for neither. A stranger is never predicted more sharply than the person on the right track could be.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.fusion.snapshot import of_shape, unpack
from services.fusion.walks.stretches import BIAS, SCALE, Walk
from shared.angles import wrap

__all__ = ["WalkFilters"]

Array = NDArray[np.float64]

MOVING = 0.4
"""Metres per second below which a direction means nothing."""
LENGTH_ERROR = (0.2, 0.2)
"""Standard deviation of a second's walk by steps: metres, and share of its length."""
TRACK_ERROR = 0.2
"""Metres; of a track's displacement, across its direction."""
HEADING_ERROR = math.radians(12.0)
"""Of a second's mean heading against the direction walked, beyond what the sender says."""
BIAS_WALK = math.radians(4.0)
"""By which a walk's heading bias wanders, per √s."""
STRANGER_TURN = math.radians(12.0)
STRANGER_SPEED = 0.15
"""How a stranger's direction and speed (m/s) wander in a second, most of the time …"""
STRANGER_CHANGES = 0.1
"""… and how often they change at random."""
OUTLIER = 0.05
"""Share of seconds in which a phone's walk is simply wrong."""
LIMIT = 4.0
"""No second says more than this, in nats."""


@dataclass
class WalkFilters:
    """What is known of d devices' walks under k hypotheses.

    Attributes:
        bias, bias_variance: (d, k), of the heading if the device is on that track, rad and rad².
        scale, scale_variance: (d, k), by which lengths told are too large.
        last: (d, 3), the device's stretch before: its end, its speed (m/s), its heading (NaN for none).
        number: (d,), of the walk.
    """

    bias: Array
    bias_variance: Array
    scale: Array
    scale_variance: Array
    last: Array
    number: NDArray[np.int64]

    @classmethod
    def new(cls, devices: int, tracks: int) -> WalkFilters:
        """Return filters that have seen nothing."""
        shape = (devices, tracks)
        return cls(
            bias=np.zeros(shape),
            bias_variance=np.full(shape, BIAS**2),
            scale=np.ones(shape),
            scale_variance=np.full(shape, SCALE**2),
            last=np.full((devices, 3), np.nan),
            number=np.full(devices, -1),
        )

    def begin(self, device: int, walk: Walk) -> None:
        """Forget bias and scale where a new walk has begun."""
        if self.number[device] != walk.number:
            self.bias[device], self.bias_variance[device] = 0.0, walk.bias_variance
            self.scale[device], self.scale_variance[device] = 1.0, walk.scale_variance
            self.number[device] = walk.number

    def walk(self, device: int, columns: NDArray[np.int64], walk: Walk, displacement: Array) -> Array:
        """Return what one stretch says for each track, nats against a stranger, and learn from it.

        Args:
            device: whose walk.
            columns: (n,) the tracks.
            walk: the stretch.
            displacement: (n, 2), how far each track moved meanwhile, metres.
        """
        duration = walk.t - walk.t_start
        moved = np.hypot(displacement[:, 0], displacement[:, 1])
        before_t, before_speed, before_heading = self.last[device].tolist()
        if not abs(walk.t_start - before_t) < 2.0:
            before_speed = before_heading = math.nan
        evidence = self._length(device, columns, walk, moved, before_speed)
        if math.isfinite(walk.heading):
            evidence += self._turn(device, columns, walk, displacement, moved, before_heading)
        self.last[device] = (walk.t, walk.length / duration, walk.heading)
        limited: Array = np.minimum(np.maximum(evidence, -LIMIT), LIMIT)
        return limited

    def _length(self, device: int, columns: NDArray[np.int64], walk: Walk, moved: Array, before: float) -> Array:
        duration = walk.t - walk.t_start
        scale, variance = self.scale[device, columns], self.scale_variance[device, columns]
        own = LENGTH_ERROR[0] ** 2 + (LENGTH_ERROR[1] * moved) ** 2
        spread = own + variance * moved**2
        surprise = walk.length - scale * moved
        for_track = _with_outliers(_normal(surprise, spread), 0.5)
        gain = np.where(surprise**2 < 9.0 * spread, variance * moved / spread, 0.0)
        self.scale[device, columns] = scale + gain * surprise
        self.scale_variance[device, columns] = variance * (1.0 - gain * moved)
        against = _stranger_length(walk.length / duration, before) / duration
        if walk.length == 0.0 and before == 0.0:
            # To go on standing is what everybody does who stands: it says nothing for anybody.
            against = max(against, _with_outliers(_normal(np.zeros(1), np.full(1, LENGTH_ERROR[0] ** 2)), 0.5)[0])
        evidence: Array = np.log(for_track / against)
        return evidence

    def _turn(
        self,
        device: int,
        columns: NDArray[np.int64],
        walk: Walk,
        displacement: Array,
        moved: Array,
        before: float,
    ) -> Array:
        duration = walk.t - walk.t_start
        bias = self.bias[device, columns]
        variance = self.bias_variance[device, columns] + BIAS_WALK**2 * duration
        moving = moved > MOVING * duration
        direction = np.arctan2(displacement[:, 1], displacement[:, 0])
        error = HEADING_ERROR**2 + walk.heading_variance + (TRACK_ERROR / np.maximum(moved, 0.1)) ** 2
        spread = variance + error
        surprise = wrap(walk.heading - direction - bias)
        density = _normal(surprise, spread)
        if math.isfinite(walk.other):
            second = wrap(walk.other - direction - bias)
            rival = _normal(second, spread)
            p = walk.other_probability
            surprise = np.where(p * rival > (1.0 - p) * density, second, surprise)
            density = (1.0 - p) * density + p * rival
        for_track = np.where(moving, _with_outliers(density, 0.5 / math.pi), 0.5 / math.pi)
        gain = np.where(moving & (np.abs(surprise) < 3.0 * np.sqrt(spread)), variance / spread, 0.0)
        self.bias[device, columns] = bias + gain * surprise
        self.bias_variance[device, columns] = np.maximum(variance * (1.0 - gain), math.radians(2.0) ** 2)
        against = 0.5 / math.pi
        if math.isfinite(before):
            turn = wrap(np.array(walk.heading - before))
            floor = HEADING_ERROR**2 + walk.heading_variance + (TRACK_ERROR / max(walk.length, 0.1)) ** 2
            steady = float(_normal(turn, np.array(STRANGER_TURN**2 + floor)))
            against = (1.0 - STRANGER_CHANGES) * steady + STRANGER_CHANGES * against
        result: Array = np.log(for_track / against)
        return result

    def inherit(self, devices: NDArray[np.int64], column: int, parents: NDArray[np.int64]) -> None:
        """Let one hypothesis of each device go on from what another knew of its walk."""
        for array in (self.bias, self.bias_variance, self.scale, self.scale_variance):
            array[devices, column] = array[devices, parents]

    def resize(self, devices: int, tracks: int) -> None:
        """Make room for more."""
        grown = WalkFilters.new(devices, tracks)
        for field in fields(self):
            old, new = getattr(self, field.name), getattr(grown, field.name)
            new[tuple(slice(0, size) for size in (old.shape[:2] if field.name != "last" else old.shape))] = old
            setattr(self, field.name, new)

    def reset_device(self, device: int) -> None:
        """Forget a device."""
        fresh = WalkFilters.new(1, 1)
        for field in fields(self):
            getattr(self, field.name)[device] = (
                getattr(fresh, field.name)[0] if field.name == "last" else (getattr(fresh, field.name).flat[0])
            )

    def reset_track(self, column: int) -> None:
        """Forget a track."""
        self.bias[:, column], self.bias_variance[:, column] = 0.0, BIAS**2
        self.scale[:, column], self.scale_variance[:, column] = 1.0, SCALE**2

    def state(self, devices: NDArray[np.int64], columns: NDArray[np.int64]) -> dict[str, Any]:
        """Return copies of what is kept of these devices and columns."""
        pairs = np.ix_(devices, columns)
        return {name: getattr(self, name)[devices if name in _BY_DEVICE else pairs] for name in _FIELDS}

    def restore(self, state: dict[str, Any], devices: NDArray[np.int64], columns: NDArray[np.int64]) -> None:
        """Go on from ``state()``, the arrays having room already."""
        pairs = np.ix_(devices, columns)
        for name in _FIELDS:
            array, used = getattr(self, name), devices if name in _BY_DEVICE else pairs
            array[used] = of_shape(unpack(state[name]), array[used].shape)


_BY_DEVICE = ("last", "number")
_FIELDS = ("bias", "bias_variance", "scale", "scale_variance", *_BY_DEVICE)


def _normal(error: Array, variance: Array) -> Array:
    density: Array = np.exp(-0.5 * error**2 / variance) / np.sqrt(2.0 * math.pi * variance)
    return density


def _with_outliers(density: Array, flat: float) -> Array:
    return (1.0 - OUTLIER) * density + OUTLIER * flat


def _stranger_length(speed: float, before: float) -> float:
    """Density, per m/s, of a stranger's speed: like the second before, or anything up to 2 m/s."""
    flat = 0.5
    if not math.isfinite(before):
        return flat
    sigma = math.hypot(STRANGER_SPEED, LENGTH_ERROR[0] + LENGTH_ERROR[1] * before)
    steady = math.exp(-0.5 * ((speed - before) / sigma) ** 2) / (sigma * math.sqrt(2.0 * math.pi))
    return (1.0 - STRANGER_CHANGES) * steady + STRANGER_CHANGES * flat
