"""What does path loss not explain, and how alike is it from place to place? The same questions to real and simulated.

A path-loss line is fitted for each transmitter, its place too where that is not known; the rest is looked at as a
random field over the plan (correlation against distance between places), along each walk, by where the carrier faced,
and by how often weak transmitters are missed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks.radio_recordings import Readings
from services.simulator.radio.wall_loss import Barriers
from shared.angles import wrap

__all__ = [
    "BINS",
    "Curve",
    "PathLossFit",
    "body_effect",
    "correlation",
    "exponential",
    "fit_path_loss",
    "means",
    "missed_at_rest",
    "missed_between",
    "moments",
    "path_loss_line",
    "rest",
    "wall_effect",
]

Array = NDArray[np.float64]

BINS = np.array([0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0])
"""Edges of the classes of distance, metres."""
LEVELS = np.arange(-97.0, -50.0, 3.0)
"""Edges of the classes of received power, dBm."""
_MOST = 500  # readings of a transmitter whose pairs are counted
_FEWEST = 200  # pairs for a class to count


@dataclass(frozen=True, slots=True)
class PathLossFit:
    """One path-loss line for each of k transmitters.

    Attributes:
        place: (k, 3) metres.
        power_1m: (k,) dBm.
        exponent: (k,).
        residual: (n,) dB, of each reading.
    """

    place: Array
    power_1m: Array
    exponent: Array
    residual: Array


@dataclass(frozen=True, slots=True)
class Curve:
    """A quantity by classes: ``x`` (c,) their middles, ``y`` (c,) the quantity, NaN where too little is known."""

    x: Array
    y: Array
    count: NDArray[np.int64]


def fit_path_loss(readings: Readings) -> PathLossFit:
    """Return the least-squares lines; a transmitter's place is searched for where it is not known."""
    k = readings.transmitters
    place, power, exponent = np.zeros((k, 3)), np.zeros(k), np.zeros(k)
    residual = np.zeros(len(readings.rssi))
    for column in range(k):
        mine = readings.transmitter == column
        points, rssi = readings.position[mine], readings.rssi[mine]
        place[column] = _place_of(points, rssi) if readings.place is None else readings.place[column]
        power[column], exponent[column] = path_loss_line(points, rssi, place[column])
        logs = -10.0 * np.log10(_distance(points, place[column]))
        residual[mine] = rssi - power[column] - exponent[column] * logs
    return PathLossFit(place, power, exponent, residual)


def path_loss_line(points: Array, rssi: Array, place: Array) -> tuple[float, float]:
    """Return P0 and exponent, the latter within [0.5, 6], of readings (n,) at points (n, 2) of a transmitter (3,)."""
    logs = -10.0 * np.log10(_distance(points, place))
    exponent, power = np.polyfit(logs, rssi, 1)
    if not 0.5 <= exponent <= 6.0:
        exponent = float(np.clip(exponent, 0.5, 6.0))
        power = (rssi - exponent * logs).mean()
    return float(power), float(exponent)


def moments(values: Array) -> tuple[float, float, float]:
    """Return standard deviation, skewness and excess kurtosis."""
    centred = values - values.mean()
    sigma = float(centred.std())
    return sigma, float((centred**3).mean() / sigma**3), float((centred**4).mean() / sigma**4 - 3.0)


def correlation(
    readings: Readings, residual: Array, alike: Callable[[NDArray[np.int64], NDArray[np.int64]], NDArray[np.bool_]]
) -> Curve:
    """Return the correlation of residuals of one transmitter by the distance between the places.

    Args:
        readings: what was heard.
        residual: (n,) dB.
        alike: chooses among pairs of readings, given their indices (p,) and (p,).
    """
    product, count, apart = (np.zeros(len(BINS) - 1) for _ in range(3))
    rng = np.random.default_rng(0)
    for column in range(readings.transmitters):
        mine = np.flatnonzero(readings.transmitter == column)
        if len(mine) > _MOST:
            mine = np.sort(rng.choice(mine, _MOST, replace=False))
        i, j = np.triu_indices(len(mine), 1)
        i, j = mine[i], mine[j]
        distance = np.hypot(*(readings.position[i] - readings.position[j]).T)
        near = distance < BINS[-1]
        i, j, distance = i[near], j[near], distance[near]
        chosen = alike(i, j)
        i, j, distance = i[chosen], j[chosen], distance[chosen]
        kind = np.digitize(distance, BINS) - 1
        product += np.bincount(kind, residual[i] * residual[j], minlength=len(product))
        apart += np.bincount(kind, distance, minlength=len(product))
        count += np.bincount(kind, minlength=len(product))
    known = count >= _FEWEST
    safe = np.maximum(count, 1.0)
    return Curve(
        np.where(known, apart / safe, 0.5 * (BINS[1:] + BINS[:-1])),
        np.where(known, product / safe / residual.var(), np.nan),
        count.astype(np.int64),
    )


def exponential(curve: Curve) -> tuple[float, float]:
    """Return the correlation at no distance, and the length in metres, of the exponential that fits a curve best.

    Log-distance lines swallow the field's mean, so far pairs are a little anti-correlated: the exponential may tend to
    a constant below zero.
    """
    known = np.isfinite(curve.y)
    x, y = curve.x[known], curve.y[known]
    weight = np.sqrt(np.minimum(curve.count[known], 20_000))

    def misfit(p: Array) -> Array:
        missing: Array = weight * (p[0] * np.exp(-x / p[1]) - p[2] - y)
        return missing

    found = least_squares(
        misfit,
        [0.5, 2.0, 0.0],
        bounds=([0.0, 0.2, 0.0], [1.0, 30.0, 0.2]),
    )
    return float(found.x[0] - found.x[2]), float(found.x[1])


def body_effect(readings: Readings, fit: PathLossFit) -> tuple[float, Curve]:
    """Return by how many dB what lies ahead is heard better than what lies behind, and the curve by angle (degrees).

    Twice the coefficient of the cosine of the angle between where the carrier goes and the transmitter.
    """
    toward = fit.place[readings.transmitter, :2] - readings.position
    angle = np.arctan2(toward[:, 1], toward[:, 0]) - readings.heading
    known = np.isfinite(angle) & (np.hypot(*toward.T) > 2.0)
    angle, residual = np.abs(wrap(angle[known])), fit.residual[known]
    cosine = np.cos(angle)
    slope = float(np.cov(cosine, residual)[0, 1] / cosine.var(ddof=1))
    edges = np.linspace(0.0, np.pi, 7)
    kind = np.digitize(angle, edges[1:-1])
    count = np.bincount(kind, minlength=6)
    mean = np.bincount(kind, residual, minlength=6) / np.maximum(count, 1)
    return 2.0 * slope, Curve(np.degrees(0.5 * (edges[1:] + edges[:-1])), mean, count)


def wall_effect(readings: Readings, fit: PathLossFit, walls: Sequence[Array]) -> float:
    """Return how many dB a further wall between phone and transmitter costs, all transmitters' lines fitted anew.

    Places that were searched for are off by metres, so this is less than a wall really costs.
    """
    barriers = Barriers((wall, 1.0) for wall in walls)
    above = below = 0.0
    for column in range(readings.transmitters):
        mine = readings.transmitter == column
        points, residual = readings.position[mine], fit.residual[mine]
        count = barriers.between(points, fit.place[column, :2])
        explained = np.column_stack([np.ones(len(points)), np.log10(_distance(points, fit.place[column]))])
        rest_of_count = count - explained @ np.linalg.lstsq(explained, count, rcond=None)[0]
        above -= rest_of_count @ residual
        below += rest_of_count @ rest_of_count
    return float(above / below)


def rest(readings: Readings) -> Array:
    """Return how readings waver at rest: the standard deviation at each point and transmitter, (links,), dB."""
    key = readings.walk * readings.transmitters + readings.transmitter
    count = np.bincount(key)
    mean = np.bincount(key, readings.rssi) / np.maximum(count, 1)
    square = np.bincount(key, (readings.rssi - mean[key]) ** 2) / np.maximum(count, 1)
    deviation: Array = np.sqrt(square[count >= 100])
    return deviation


def means(readings: Readings) -> Readings:
    """Return one reading for each point and transmitter: the mean of those at rest."""
    key = readings.walk * readings.transmitters + readings.transmitter
    _, first, place = np.unique(key, return_index=True, return_inverse=True)
    place = place.ravel()
    return replace(
        readings,
        transmitter=readings.transmitter[first],
        walk=readings.walk[first],
        scan=readings.scan[first],
        t=readings.t[first],
        position=readings.position[first],
        heading=readings.heading[first],
        rssi=np.bincount(place, readings.rssi) / np.bincount(place),
    )


def missed_at_rest(readings: Readings) -> Curve:
    """Return the share of adverts missed by mean received power, at rest: one value for each point and transmitter."""
    k = readings.transmitters
    walks = int(readings.walk.max()) + 1
    sent = np.bincount(readings.scan_walk, minlength=walks)
    key = readings.walk * k + readings.transmitter
    count = np.bincount(key, minlength=walks * k)
    mean = np.bincount(key, readings.rssi, minlength=walks * k) / np.maximum(count, 1)
    heard = count >= 20
    return _by_level(mean[heard], (1.0 - count / np.repeat(sent, k))[heard])


def missed_between(readings: Readings) -> Curve:
    """Return the share missed of scans whose neighbours before and after both heard the transmitter, by their mean."""
    table = np.full((len(readings.scan_t), readings.transmitters), np.nan)
    table[readings.scan, readings.transmitter] = readings.rssi
    before, here, after = table[:-2], table[1:-1], table[2:]
    one_walk = (readings.scan_walk[:-2] == readings.scan_walk[2:])[:, None]
    both = np.isfinite(before) & np.isfinite(after) & one_walk
    return _by_level(0.5 * (before + after)[both], np.isnan(here[both]).astype(float))


def _by_level(level: Array, share: Array) -> Curve:
    kind = np.digitize(level, LEVELS) - 1
    inside = (kind >= 0) & (kind < len(LEVELS) - 1)
    count = np.bincount(kind[inside], minlength=len(LEVELS) - 1)
    total = np.bincount(kind[inside], share[inside], minlength=len(LEVELS) - 1)
    middle = 0.5 * (LEVELS[1:] + LEVELS[:-1])
    return Curve(middle, np.where(count >= 10, total / np.maximum(count, 1), np.nan), count)


def _distance(points: Array, place: Array) -> Array:
    flat = np.hypot(*(points - place[:2]).T)
    distance: Array = np.maximum(np.hypot(flat, place[2]), 0.5)
    return distance


def _place_of(points: Array, rssi: Array) -> Array:
    """Return the place (3,) from which path loss explains the readings best, near where they are strongest."""
    near = points[np.argsort(rssi)[-max(5, len(rssi) // 20) :]].mean(axis=0)
    best: tuple[float, Array] | None = None

    def misfit(p: Array) -> Array:
        missing: Array = p[2] - 10.0 * p[3] * np.log10(_distance(points, p[[0, 1, 4]])) - rssi
        return missing

    for start in (near, near + 4.0, near - 4.0):
        low = [*(near - 25.0), -75.0, 0.5, 1.0]
        high = [*(near + 25.0), -10.0, 6.0, 8.0]
        found = least_squares(
            misfit,
            [*start, -40.0, 2.5, 3.0],
            bounds=(low, high),
            loss="soft_l1",
            f_scale=6.0,
        )
        if best is None or found.cost < best[0]:
            best = (float(found.cost), found.x[[0, 1, 4]])
    return near if best is None else best[1]
