"""How well does a radio model explain scans the tracker never saw? Nats per reading, against a model of no places.

After the incremental log-likelihood ratio of a track [ravel-thesis §8.1, Eq. 5.1], with three differences: what is
scored are a named track's *radio* readings, not its detections; they were withheld from the tracker, so that a model
cannot praise itself for having pulled the name to where it fits; and the sum is divided by the number of readings, so
that scores of different lengths compare. Where the tracker named nobody the ratio is 0: not to know is worth nothing,
and to be wrong is worth less. Steps are scored likewise, by how far the named track went meanwhile; they are not
withheld, because what they are held against is what cameras saw.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from services.fusion.evidence.identity_settings import IdentitySettings
from services.fusion.rescore.offsets import Offsets
from services.fusion.rescore.significance import SLOT
from shared.radio import Nowhere, PathLoss, RadioNoise, ShadowingMap, expected_level

__all__ = [
    "Heard",
    "Score",
    "null_of",
    "placed_covariance",
    "places_at",
    "score_scans",
    "score_walks",
    "total",
]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

BLOCK = 60
"""Readings whose correlations are written out at once."""
TRACK_ERROR = 0.25
"""Metres by which a track's way over a second may be wrong."""
WALKING = (1.0, 0.5)
"""Mean and standard deviation of anybody's walking speed, m/s."""
LIMIT = 4.0
"""Nats."""
UNSEEN_SIGMA = 10.0
"""dB, of an access point read once or twice."""
CARRIER = IdentitySettings().shadowing_known
"""dB by which visits to one spot differ whatever a map knows of the spot: who carries the phone, and how they face.
Trackers believe it too; without it a map that makes names better looks worse than none, for it seems too sure."""
LEARNED = 1.5
"""dB by which what a learned model says of an access point may be off for everybody: it drifts."""
NAME_ERROR = 0.5
"""dB² added per reading for a place that is right to a few tenths of a metre only."""


@dataclass(frozen=True)
class Heard:
    """One device's withheld readings, in order of time.

    Attributes:
        t: (n,) s.
        level: (n,) dBm.
        access_point: (n,) which ones.
        places: (n, 2) metres where the tracker had the device; NaN where it named nobody.
    """

    t: Array
    level: Array
    access_point: Integers
    places: Array


@dataclass(frozen=True)
class Score:
    """Sums over one device's withheld readings.

    Attributes:
        readings: how many were withheld.
        named: how many of them were measured while a track carried the device's name.
        gain: log-likelihood at the tracks' places minus that without places, nats.
        slots: of it by block of ``SLOT`` seconds, and
        count: of the readings.
    """

    readings: int = 0
    named: int = 0
    gain: float = 0.0
    slots: Mapping[int, float] = field(default_factory=dict)
    count: Mapping[int, int] = field(default_factory=dict)

    def __add__(self, other: Score) -> Score:
        """Return the sums over both."""
        slots = {slot: self.slots.get(slot, 0.0) + other.slots.get(slot, 0.0) for slot in {*self.slots, *other.slots}}
        count = {slot: self.count.get(slot, 0) + other.count.get(slot, 0) for slot in {*self.count, *other.count}}
        return Score(self.readings + other.readings, self.named + other.named, self.gain + other.gain, slots, count)

    @property
    def per_reading(self) -> float:
        """Nats per withheld reading; 0 where there is none."""
        return self.gain / self.readings if self.readings else 0.0


def score_scans(
    devices: Sequence[Heard],
    null: Nowhere,
    radio: PathLoss,
    shadowing: ShadowingMap | None,
    noise: RadioNoise,
) -> list[Score]:
    """Return the score of each device's withheld readings.

    Blocks of readings are scored in order of time, all devices in turn: what is learned of an access point from one
    phone is known when the next is scored, under the model and without places alike.

    Args:
        devices: what was withheld, and where the tracker had each device.
        null: each access point's readings, wherever they were made.
        radio: the model of the m access points. What is heard of those it does not place is foretold no better than
            without places: it gains nothing and costs nothing.
        shadowing: what was learned beyond it.
        noise: what the model does not explain.
    """
    points = len(radio.names)
    constants = np.full(points, noise.access_point if shadowing is None else LEARNED)
    model = Offsets(len(devices), noise.device, constants)
    nowhere = Offsets(len(devices), noise.device, np.zeros(points))
    known = [np.flatnonzero(np.isfinite(heard.places).all(axis=1)) for heard in devices]
    told = [rows[radio.placed[heard.access_point[rows]]] for rows, heard in zip(known, devices, strict=True)]
    blocks = [
        (float(devices[number].t[rows[start]]), number, rows[start : start + BLOCK])
        for number, rows in enumerate(told)
        for start in range(0, len(rows), BLOCK)
    ]
    slots: list[dict[int, float]] = [defaultdict(float) for _ in devices]
    for begin, number, rows in sorted(blocks, key=lambda block: block[:2]):
        heard = devices[number]
        level, columns, spots = heard.level[rows], heard.access_point[rows], heard.places[rows]
        expected, unknown = expected_level(spots, columns, radio, shadowing)
        variance = np.full(len(rows), noise.shadowing**2) if unknown is None else unknown + CARRIER**2
        covariance = placed_covariance(spots, columns, variance, noise)
        gain = model.log_likelihood(level - expected, number, columns, covariance)
        covariance = null.covariance(heard.t[rows], columns, noise.white**2)
        gain -= nowhere.log_likelihood(level - null.level[columns], number, columns, covariance)
        slots[number][math.floor(begin / SLOT)] += gain
    return [
        Score(len(heard.level), len(rows), sum(gained.values()), gained, _by_slot(heard.t))
        for heard, rows, gained in zip(devices, known, slots, strict=True)
    ]


def score_walks(t: Array, length: Array, variance: Array, duration: Array, moved: Array) -> Score:
    """Return the score of one device's stretches of steps: each counts as one reading.

    A stretch is scored by how far the named track went meanwhile, against anybody who walks; no stretch says more than
    ``LIMIT``.

    Args:
        t: (n,) when each stretch ended, s.
        length: (n,) sum of the step lengths under the model, metres.
        variance: (n,) of it, m².
        duration: (n,) s.
        moved: (n,) how far the track went, metres; NaN where nobody had the name.
    """
    known = np.isfinite(moved)
    spread = variance[known] + TRACK_ERROR**2
    usual, usual_spread = WALKING[0] * duration[known], (WALKING[1] * duration[known]) ** 2 + TRACK_ERROR**2
    model = -0.5 * ((moved[known] - length[known]) ** 2 / spread + np.log(spread))
    anybody = -0.5 * ((moved[known] - usual) ** 2 / usual_spread + np.log(usual_spread))
    gain = np.minimum(np.maximum(model - anybody, -LIMIT), LIMIT)
    slots: dict[int, float] = defaultdict(float)
    for slot, nats in zip(np.floor(t[known] / SLOT).astype(int).tolist(), gain.tolist(), strict=True):
        slots[slot] += nats
    return Score(len(length), int(known.sum()), float(gain.sum()), slots, _by_slot(t))


def _by_slot(t: Array) -> dict[int, int]:
    slot, count = np.unique(np.floor(t / SLOT).astype(np.int64), return_counts=True)
    return dict(zip(slot.tolist(), count.tolist(), strict=True))


def placed_covariance(places: Array, access_point: Integers, shadowing: Array, noise: RadioNoise) -> Array:
    """Return (n, n) dB², of one device's readings less what a model expects, but for offsets.

    As in ``shared.radio.log_likelihood``, except that the variance of shadowing differs from reading to reading:
    ``shadowing`` is (n,), dB².
    """
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    same = access_point[:, None] == access_point[None]
    sigma = np.sqrt(shadowing)
    shared = same * np.outer(sigma, sigma) * np.exp(-apart / noise.shadowing_range)
    covariance: Array = shared + (noise.white**2 + NAME_ERROR) * np.eye(len(places))
    return covariance


def null_of(level: Array, access_point: Integers, points: int, noise: RadioNoise) -> Nowhere:
    """Return what (n,) readings of m = ``points`` access points are like wherever they were made."""
    count = np.bincount(access_point, minlength=points)
    total = np.bincount(access_point, weights=level, minlength=points)
    mean = total / np.maximum(count, 1)
    squares = np.bincount(access_point, weights=(level - mean[access_point]) ** 2, minlength=points)
    variance = np.where(count > 2, squares / np.maximum(count - 1, 1), UNSEEN_SIGMA**2 + noise.device**2)
    return Nowhere.of(mean, variance, noise.white**2, noise.device**2)


def places_at(times: Array, frames: Array, path: Array, longest: float) -> Array:
    """Return (n, 2) places at ``times``: between two frames in which the device was named, no farther apart in time.

    Args:
        times: (n,) s.
        frames: (f,) s, of the frames that named the device, ascending.
        path: (f, 2) where, metres.
        longest: seconds between two frames, or from a frame to a time beyond it, that may be bridged.
    """
    places = np.full((len(times), 2), np.nan)
    if not len(frames):
        return places
    after = np.searchsorted(frames, times)
    left, right = np.maximum(after - 1, 0), np.minimum(after, len(frames) - 1)
    gap = frames[right] - frames[left]
    bridged = (gap > 0.0) & (gap <= 2.0 * longest)
    share = np.where(bridged, (times - frames[left]) / np.where(bridged, gap, 1.0), 0.0)
    nearest = np.where(np.abs(times - frames[left]) <= np.abs(times - frames[right]), left, right)
    between = path[left] + share[:, None] * (path[right] - path[left])
    found = np.where(bridged[:, None], between, path[nearest])
    known = bridged | (np.abs(times - frames[nearest]) <= longest)
    places[known] = found[known]
    return places


def total(scores: Sequence[Score]) -> Score:
    """Return the sums over all devices."""
    return sum(scores, Score())
