"""Who is where, by pairing tracks and phones once per minute? EV-Loc (Zhang et al., 2012) [ravel-thesis §10].

1. Anonymous tracks by global nearest neighbour (``constant_velocity``).
2. Tracks become distances to the access points; signal strengths become distances by inverting a known radio model.
3. Per window, the assignment of devices to tracks with the least sum of distances between these vectors (Eq. 3.9).
4. The place is 0.7 times what is seen and 0.3 times what is heard (Eq. 3.10).

Off line: the answer for a window is known at its end. What the original leaves open is settled here as follows. Signal
strengths (dBm) of half a second before to half a second after each time are averaged. A distance cannot be longer than
from the access point to the far corner of the view. Access points that were not heard are left out and the difference
is scaled to the number of all. A time at which a track is not there counts as the mean difference to somebody anywhere
in view, so that a short track has to be better than a long one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from benchmarks.baselines.anonymous_tracks import AnonymousTracks
from benchmarks.baselines.constant_velocity import ConstantVelocityParameters, track
from benchmarks.baselines.survey import readings_of
from benchmarks.world_record import WorldRecord
from shared.radio import PathLoss
from shared.radio.path_loss import DEVICE_HEIGHT, NEAREST

__all__ = ["EvLocParameters", "locate", "locate_on_tracks", "trilaterate"]

Array = NDArray[np.float64]

GRID = 5
"""Places along each side of the view that stand for anywhere in it."""


@dataclass(frozen=True, slots=True)
class EvLocParameters:
    """The settings; window and weights are the original study's.

    Attributes:
        window: seconds over which tracks and devices are paired once.
        rate: times per second at which distances are compared.
        seen: weight α of what is seen; 1 − α is that of what is heard.
        fuse: whether places are averaged (heard ones found by trilateration) or distances (and then trilaterated).
        average: signal strengths this many seconds before and after a time are averaged.
        tracks: of the tracker.
    """

    window: float = 60.0
    rate: float = 2.0
    seen: float = 0.7
    fuse: Literal["positions", "distances"] = "positions"
    average: float = 0.5
    tracks: ConstantVelocityParameters = field(default_factory=ConstantVelocityParameters)

    def __post_init__(self) -> None:
        """Refuse settings without a meaning."""
        for name in ("window", "rate", "average"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: {getattr(self, name)} is not allowed; it must be positive")
        if not 0.0 <= self.seen <= 1.0:
            raise ValueError(f"seen: {self.seen} is not allowed; 0 to 1")
        if self.fuse not in ("positions", "distances"):
            raise ValueError(f"fuse: {self.fuse!r} is not allowed; positions or distances")


def locate(
    record: WorldRecord, model: PathLoss, times: Array, parameters: EvLocParameters | None = None
) -> Mapping[str, Array]:
    """Return where each phone is at ``times``, (n, 2) by device; NaN while it is paired with nobody in sight.

    Args:
        record: its detections and radio scans are used.
        model: the known radio model.
        times: (n,) seconds since the epoch, not decreasing; windows count from the first.
        parameters: of the method.
    """
    chosen = parameters or EvLocParameters()
    return locate_on_tracks(record, model, track(record, times, chosen.tracks), chosen)


def locate_on_tracks(
    record: WorldRecord, model: PathLoss, tracks: AnonymousTracks, parameters: EvLocParameters | None = None
) -> Mapping[str, Array]:
    """Return where each phone is at the times of ``tracks``, (n, 2) by device; NaN as in ``locate``."""
    chosen = parameters or EvLocParameters()
    devices = list(record.scans)
    times = tracks.t
    places = np.full((len(devices), len(times), 2), np.nan)
    if not devices or len(times) == 0:
        return dict(zip(devices, places, strict=True))
    heard = np.stack([_heard_distances(record, device, model, times, chosen) for device in devices])
    # The thousandth of a period forgives what rounding does to times that are multiples of it.
    since = times - times[0] + 1e-3 / chosen.rate
    window = np.floor(since / chosen.window).astype(np.int64)
    compared = np.diff(np.floor(since * chosen.rate), prepend=-1.0) > 0.0
    for this in np.unique(window):
        first, last = np.searchsorted(window, [this, this + 1]).tolist()
        _, seen = tracks.between(first, last)
        some = compared[first:last]
        for device, which in _pairs(seen[some], heard[:, first:last][:, some], model, record.view):
            places[device, first:last] = _fuse(seen[:, which], heard[device, first:last], model, record.view, chosen)
    return dict(zip(devices, places, strict=True))


def trilaterate(distances: Array, model: PathLoss, first: Array, view: Array) -> Array:
    """Return the places (n, 2) that fit distances (n, m) to the access points best; NaN where fewer than 3 are known.

    Gauss–Newton with damping on relative errors, since a decibel is a share of the distance; held to the view's box.

    Args:
        distances: metres in space; NaN where unknown.
        model: where the access points are.
        first: (n, 2), first guesses.
        view: (c, 2), corners.
    """
    known = np.isfinite(distances)
    weight = np.where(known, 1.0 / np.maximum(np.where(known, distances, 1.0), 1.0) ** 2, 0.0)
    target = np.where(known, distances, 0.0)
    rise = model.positions[:, 2] - DEVICE_HEIGHT
    low, high = view.min(axis=0), view.max(axis=0)
    places = np.clip(first, low, high)
    for _ in range(12):
        offset = places[:, None] - model.positions[None, :, :2]
        length = np.maximum(np.sqrt((offset**2).sum(axis=2) + rise**2), NEAREST)
        slope = offset / length[:, :, None]
        gradient = np.einsum("nm,nmi->ni", weight * (target - length), slope)
        curvature = np.einsum("nm,nmi,nmj->nij", weight, slope, slope)
        damping = 1e-3 * np.trace(curvature, axis1=1, axis2=2) + 1e-9
        step = np.linalg.solve(curvature + damping[:, None, None] * np.eye(2), gradient[:, :, None])[:, :, 0]
        places = np.clip(places + step, low, high)
    result: Array = np.where((known.sum(axis=1) >= 3)[:, None], places, np.nan)
    return result


def _heard_distances(
    record: WorldRecord, device: str, model: PathLoss, times: Array, parameters: EvLocParameters
) -> Array:
    """Return distances (n, m) in metres by inverting the radio model; NaN where not heard."""
    t, readings = readings_of(record.scans[device], model.names)
    present = np.isfinite(readings)
    sums = np.vstack([np.zeros(readings.shape[1]), np.cumsum(np.where(present, readings, 0.0), axis=0)])
    counts = np.vstack([np.zeros(readings.shape[1]), np.cumsum(present, axis=0)])
    first = np.searchsorted(t, times - parameters.average, side="left")
    last = np.searchsorted(t, times + parameters.average, side="right")
    count = counts[last] - counts[first]
    power = np.where(count > 0, (sums[last] - sums[first]) / np.maximum(count, 1.0), np.nan)
    farthest = _distances(record.view, model).max(axis=0)
    distances: Array = np.clip(10.0 ** ((model.power_1m - power) / (10.0 * model.exponent)), NEAREST, farthest)
    return distances


def _distances(places: Array, model: PathLoss) -> Array:
    """Return the distances in space (…, m) from places (…, 2), at phone height, to the access points."""
    distance: Array = 10.0 ** (model.log_distance(places.reshape(-1, 2)) / 10.0)
    return distance.reshape(*places.shape[:-1], len(model.names))


def _pairs(seen: Array, heard: Array, model: PathLoss, view: Array) -> list[tuple[int, int]]:
    """Return (device, track) pairs of one window: tracks ``seen`` (w, m, 2), distances ``heard`` (d, w, k)."""
    difference = _differences(_distances(seen, model), heard)
    low, high = view.min(axis=0), view.max(axis=0)
    spread = (np.arange(GRID) + 0.5) / GRID
    anywhere = low + (high - low) * np.stack(np.meshgrid(spread, spread), axis=-1).reshape(1, -1, 2)
    of_anybody = _differences(_distances(anywhere, model), heard).mean(axis=2, keepdims=True)
    listened = np.isfinite(of_anybody[:, :, 0])
    able = np.flatnonzero(listened.any(axis=1))
    cost = np.where(np.isfinite(difference), difference, of_anybody)
    cost = np.where(listened[:, :, None], cost, 0.0).sum(axis=1)[able]
    row, which = linear_sum_assignment(cost)
    return list(zip(able[row].tolist(), which.tolist(), strict=True))


def _differences(by_sight: Array, heard: Array) -> Array:
    """Return ‖x − y‖ (d, w, m) of ``by_sight`` (w, m, k) and ``heard`` (d, w, k) distances; NaN if one is unknown."""
    known = np.isfinite(heard)
    apart = np.where(known[:, :, None], by_sight - np.where(known, heard, 0.0)[:, :, None], 0.0)
    share = np.where(known.any(axis=2), known.mean(axis=2), np.nan)
    difference: Array = np.sqrt((apart**2).sum(axis=3) / share[:, :, None])
    return difference


def _fuse(seen: Array, heard: Array, model: PathLoss, view: Array, parameters: EvLocParameters) -> Array:
    """Return the places (w, 2) of a track (w, 2) paired with a device whose distances are ``heard`` (w, k)."""
    places = seen.copy()
    both = np.isfinite(seen[:, 0]) & (np.isfinite(heard).sum(axis=1) >= 3)
    if not both.any():
        return places
    if parameters.fuse == "distances":
        distances = parameters.seen * _distances(seen[both], model) + (1.0 - parameters.seen) * heard[both]
        places[both] = trilaterate(distances, model, seen[both], view)
    else:
        centre = np.broadcast_to(view.mean(axis=0), seen[both].shape)
        alone = trilaterate(heard[both], model, centre, view)
        places[both] = parameters.seen * seen[both] + (1.0 - parameters.seen) * alone
    return places
