"""The identity filter as plain loops over particles, devices and whole composites, on ``filterpy``: slow and plain.

A composite is one measurement [x, y, RSS_1 .. RSS_M] of one ``UnscentedKalmanFilter`` [ravel-thesis §6.2, §6.3], with
sigma points of all 2 + M dimensions (alpha 1, beta 2, n + kappa = 3). The array code takes radio and camera in
one after the other with five points; nothing of it is used here but its inputs and outputs.
"""

import copy
import math
from dataclasses import dataclass

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from numpy.typing import NDArray

from services.fusion.rbmcda.particles import Cycle, Draws
from services.fusion.rbmcda.settings import RbmcdaSettings

Array = NDArray[np.float64]


@dataclass
class Target:
    """One device of one particle."""

    x: Array
    spread: Array
    weight: float
    fed: bool = False
    link: int = -1


def density(error: Array, covariance: Array) -> float:
    misfit = float(error @ np.linalg.solve(covariance, error))
    return math.exp(-0.5 * misfit) / math.sqrt(float(np.linalg.det(2.0 * math.pi * covariance)))


def bank(target: Target, cycle: Cycle, rows: list[int], noise: Array) -> UnscentedKalmanFilter:
    """A filter at the target's state whose measurement is the ``rows`` of the composite."""
    n = len(target.x)

    def composite(x: Array) -> Array:
        level = cycle.expected(x[None, :2])[0] + x[2:]
        return np.concatenate([x[:2], level])[rows]

    points = MerweScaledSigmaPoints(n, alpha=1.0, beta=2.0, kappa=3.0 - n)
    ukf = UnscentedKalmanFilter(n, len(rows), 1.0, composite, lambda x, dt: x, points)
    ukf.x, ukf.P, ukf.R = target.x.copy(), target.spread.copy(), noise
    ukf.sigmas_f = points.sigma_points(ukf.x, ukf.P)
    return ukf


def updated(target: Target, cycle: Cycle, device: int, sighting: int | None) -> tuple[Array, Array]:
    """The state after a composite, or after the scan alone."""
    heard = np.flatnonzero(np.isfinite(cycle.reading[:, device]))
    rows = [2 + int(m) for m in heard]
    z, noise = cycle.reading[heard, device], np.diag(cycle.noise[heard, device])
    if sighting is not None:
        rows = [0, 1, *rows]
        z = np.concatenate([cycle.places[sighting], z])
        whole = np.zeros((len(z), len(z)))
        whole[:2, :2], whole[2:, 2:] = cycle.place_noise[sighting], noise
        noise = whole
    if not rows:
        return target.x, target.spread
    ukf = bank(target, cycle, rows, noise)
    ukf.update(z)
    return ukf.x, ukf.P


def scan_density(target: Target, cycle: Cycle, device: int) -> float:
    heard = np.flatnonzero(np.isfinite(cycle.reading[:, device]))
    if not len(heard):
        return 1.0
    ukf = bank(target, cycle, [2 + int(m) for m in heard], np.diag(cycle.noise[heard, device]))
    ukf.update(cycle.reading[heard, device])
    return density(ukf.y, ukf.S)


def in_view(target: Target, cycle: Cycle) -> float:
    points = MerweScaledSigmaPoints(2, alpha=1.0, beta=2.0, kappa=1.0)
    places = points.sigma_points(target.x[:2], target.spread[:2, :2])
    return float(points.Wm @ cycle.in_view(places))


def one_cycle(particles: list[list[Target]], cycle: Cycle, settings: RbmcdaSettings, draws: Draws) -> list[list[int]]:
    """Advance all particles in place and return who was seen as what; no haste and no forces."""
    count, devices = len(particles), len(particles[0])
    seen_as = [[-1] * devices for _ in range(count)]
    for n, particle in enumerate(particles):
        growth = [1.0] * devices
        for k, target in enumerate(particle):
            if not target.fed:
                target.x[:2] += cycle.owed[:, k]
            target.x[:2] += cycle.shift[:, k]
            target.spread[:2, :2] += cycle.spread[:, :, k]
            kept = np.ones(len(target.x))
            kept[2:] = cycle.kept[k]
            usual = np.concatenate([[0.0, 0.0], cycle.usual])
            target.x = usual + (target.x - usual) * kept
            target.spread = kept[:, None] * target.spread * kept
            target.spread[2:, 2:] += cycle.bias * (1.0 - cycle.kept[k] ** 2)
            growth[k] *= scan_density(target, cycle, k)
        used: set[int] = set()
        anew = set()
        for k, (mean, covariance, evidence) in cycle.anew.items():
            if draws.jump[n, k] < (settings.jump if particle[k].fed else settings.jump_unseen):
                particle[k].x, particle[k].spread, particle[k].link = mean.copy(), covariance.copy(), -1
                growth[k] = math.exp(evidence)
                anew.add(k)
        for k in draws.order.tolist():
            target = particle[k]
            x, spread = (target.x, target.spread) if k in anew else updated(target, cycle, k, None)
            after_scan = Target(x, spread, 0.0)
            same = [m for m in range(len(cycle.places)) if cycle.link[m] == target.link]
            loose = sum(cycle.switched[m] for m in same) if same else 1.0
            events = [loose * (1.0 - cycle.detection[k] * in_view(after_scan, cycle))]
            for m, place in enumerate(cycle.places):
                if m in same:
                    events.append((1.0 - cycle.switched[m]) * cycle.favour[k, m])
                    continue
                prior = loose * cycle.detection[k] / cycle.density * cycle.pickup[m]
                likelihood = density(place - x[:2], spread[:2, :2] + cycle.place_noise[m])
                events.append(prior * likelihood * (settings.merged if m in used else 1.0))
            total = sum(events)
            growth[k] *= total
            level, event = events[0], 0
            while level <= draws.uniform[n, k] * total and event < len(events) - 1:
                event += 1
                level += events[event]
            target.fed, target.link = event > 0, -1
            if event > 0:
                m = event - 1
                used.add(m)
                seen_as[n][k], target.link = m, int(cycle.link[m])
                if k in anew:
                    ukf = bank(after_scan, cycle, [0, 1], cycle.place_noise[m])
                    ukf.update(cycle.places[m])
                    x, spread = ukf.x, ukf.P
                else:
                    x, spread = updated(target, cycle, k, m)
            target.x, target.spread = x, spread
        together = math.prod(growth)
        for k, target in enumerate(particle):
            target.weight *= growth[k] if settings.separate else together
    for k in range(devices):
        total = sum(particle[k].weight for particle in particles)
        for particle in particles:
            particle[k].weight /= total
        if 1.0 / sum(particle[k].weight ** 2 for particle in particles) < settings.resample_below * count:
            resample(particles, k, float(draws.resampling[k if settings.separate else 0]))
    return seen_as


def resample(particles: list[list[Target]], k: int, draw: float) -> None:
    before = [particle[k] for particle in particles]
    level, source = before[0].weight, 0
    for n, particle in enumerate(particles):
        while level <= (draw + n) / len(particles) and source < len(before) - 1:
            source += 1
            level += before[source].weight
        particle[k] = copy.deepcopy(before[source])
        particle[k].weight = 1.0 / len(particles)
