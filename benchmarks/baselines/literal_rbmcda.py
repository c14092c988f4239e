"""Tracking and identification with the original's own composites and clutter densities [ravel-thesis §6.3, Alg. 2].

Plain arrays over particles; composites of a detection and a device's scan one after the other. ``services.fusion``
draws a device's whole assignment at once, relative to a clutter density that the radio normalises, and counts each scan
once; here each of these points [ravel-thesis §6.5] can be undone, to show what it is worth.

Radio constants are known, everybody stays in view, and a particle's devices are weighed and drawn together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from services.fusion.rbmcda.resampling import effective, systematic
from services.fusion.rbmcda.unscented import sigma_points
from shared.radio import PathLoss

__all__ = ["LiteralParameters", "LiteralRbmcda"]

Array = NDArray[np.float64]

CELL = 0.5
"""Metres between the places over which the density of a scan in the field of view is averaged."""
MEAN_WEIGHTS = np.array([1.0, 0.5, 0.5, 0.5, 0.5]) / 3.0
SPREAD_WEIGHTS = MEAN_WEIGHTS + np.array([2.0, 0.0, 0.0, 0.0, 0.0])
"""Of the sigma points, with alpha 1, kappa 1 and beta 2 [ravel-thesis §16]."""


@dataclass(frozen=True, slots=True)
class LiteralParameters:
    """The settings of the filter, and which reading of the thesis it follows.

    Attributes:
        particles: number of association histories.
        detection: probability that a device's carrier is detected in a cycle.
        process: metres along each axis that steps leave open in a cycle.
        camera: metres along each axis.
        radio: dB.
        clutter: density of a composite that is nobody's: ``radio``, normalised by the radio (§6.5a); ``box``, uniform
            over the view and ``box_width`` dB per access point; ``area``, uniform over the view alone.
        box_width: dB.
        hazard: whether a device's composites share ``detection`` (§6.5b); if not, each has all of it.
        once: whether a scan weighs its particle once per cycle (§6.5c); needs ``clutter`` ``radio``.
        radio_only: whether a scan corrects a device without a detection; the original says no.
        death: seconds without a detection after which a device is gone.
    """

    particles: int = 100
    detection: float = 0.7
    process: float = 0.25
    camera: float = 0.25
    radio: float = 4.0
    clutter: Literal["radio", "box", "area"] = "radio"
    box_width: float = 70.0
    hazard: bool = True
    once: bool = False
    radio_only: bool = False
    death: int = 30


class LiteralRbmcda:
    """K devices in N particles.

    Args:
        radio: the constants of M access points.
        extent: (2,) metres, width and depth of the view, whose corner is the origin.
        devices: how many phones there are.
        parameters: of the filter.
        seed: of all draws.

    Attributes:
        weight: (N,), summing to one.
        alive: (N, K) whether a device has been born.
        mean: (N, K, 2) metres.
        covariance: (N, K, 2, 2) m².
    """

    def __init__(self, radio: PathLoss, extent: Array, devices: int, parameters: LiteralParameters, seed: int) -> None:
        self._radio, self._parameters, self._area = radio, parameters, float(np.prod(extent))
        self._rng = np.random.default_rng([1, seed])  # apart from the world's, which may have the same seed
        x, y = (np.arange(0.5 * CELL, length, CELL) for length in extent)
        self._level = radio.rssi(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
        shape = parameters.particles, devices
        self.weight: Array = np.full(parameters.particles, 1.0 / parameters.particles)
        self.alive: NDArray[np.bool_] = np.zeros(shape, np.bool_)
        self.mean: Array = np.zeros((*shape, 2))
        self.covariance: Array = np.tile(np.eye(2), (*shape, 1, 1))
        self._unseen = np.zeros(shape, np.int64)

    def step(self, shift: Array, reading: Array, sightings: Array) -> Array:
        """Advance by a cycle and return where each device is, (K, 2); NaN for one that most particles do not hold.

        Args:
            shift: (K, 2) metres walked.
            reading: (M, K) dBm.
            sightings: (d, 2) detections, metres.
        """
        p, alive = self._parameters, self.alive
        self.mean += shift
        self.covariance += p.process**2 * np.eye(2)
        mean, covariance, evidence = self._heard(reading.T)
        scan = np.where(alive, evidence, self._anywhere(reading.T))
        growth = scan.sum(axis=1) if p.once else np.zeros(len(alive))
        likelihood = np.where(
            alive[..., None],
            evidence[..., None] + _gaussian(sightings - mean[:, :, None], covariance[:, :, None] + _round(p.camera)),
            self._born(reading.T, sightings) - math.log(self._area),
        )
        ratio = np.exp(likelihood - self._clutter(scan)[..., None])
        seen_as, grown = self._draw(ratio)
        self._look(seen_as, sightings, mean, covariance)
        log_weight = np.log(np.maximum(self.weight, 1e-300)) + growth + grown
        weight = np.exp(log_weight - log_weight.max())
        self.weight = weight / weight.sum()
        estimate = self._estimate()
        if effective(self.weight[:, None])[0] < 0.5 * p.particles:
            rows = systematic(self.weight[:, None], self._rng.random(1))[:, 0]
            self.alive, self._unseen = self.alive[rows], self._unseen[rows]
            self.mean, self.covariance = self.mean[rows], self.covariance[rows]
            self.weight = np.full(p.particles, 1.0 / p.particles)
        return estimate

    def _heard(self, reading: Array) -> tuple[Array, Array, Array]:
        """Return (N, K, 2) and (N, K, 2, 2) after the scans (K, M), and their log-densities (N, K) before."""
        points = np.moveaxis(sigma_points(self.mean.transpose(2, 0, 1), self.covariance.transpose(2, 3, 0, 1)), 1, -1)
        level = self._radio.rssi(points.reshape(-1, 2)).reshape(*points.shape[:3], -1)
        foreseen = np.einsum("s,snkm->nkm", MEAN_WEIGHTS, level)
        apart, weighted = level - foreseen, SPREAD_WEIGHTS[:, None, None, None] * (level - foreseen)
        spread = np.einsum("snkm,snkl->nkml", weighted, apart)
        spread += self._parameters.radio**2 * np.eye(reading.shape[1])
        cross = np.einsum("snkm,snki->nkmi", weighted, points - self.mean)
        surprise = reading - foreseen
        gain = np.linalg.solve(spread, cross)
        mean = self.mean + np.einsum("nkmi,nkm->nki", gain, surprise)
        covariance = self.covariance - np.einsum("nkmi,nkmj->nkij", gain, cross)
        return mean, covariance, _gaussian(surprise, spread)

    def _anywhere(self, reading: Array) -> Array:
        """Return (K,) log-densities of scans (K, M) of devices that are anywhere in view."""
        misfit = ((reading[:, None] - self._level) ** 2).sum(axis=2) / self._parameters.radio**2
        normaliser = reading.shape[1] * math.log(2.0 * math.pi * self._parameters.radio**2)
        density: Array = np.logaddexp.reduce(-0.5 * (misfit + normaliser), axis=1) - math.log(len(self._level))
        return density

    def _born(self, reading: Array, sightings: Array) -> Array:
        """Return (K, d) log-densities of scans (K, M) of devices that are where a camera says."""
        radio, p = self._radio, self._parameters
        apart = sightings[:, None] - radio.positions[:, :2]
        slope = -10.0 / math.log(10.0) * radio.exponent[:, None] * apart / (apart**2).sum(axis=2, keepdims=True)
        spread = p.camera**2 * slope @ slope.transpose(0, 2, 1) + p.radio**2 * np.eye(len(radio.exponent))
        return _gaussian(reading[:, None] - radio.rssi(sightings), spread)

    def _clutter(self, scan: Array) -> Array:
        """Return (N, K) log-densities of composites of a device that are nobody's."""
        p, flat = self._parameters, np.zeros_like(scan)
        if p.clutter == "radio":
            flat = scan
        elif p.clutter == "box":
            flat -= len(self._radio.exponent) * math.log(p.box_width)
        return flat - math.log(self._area)

    def _draw(self, ratio: Array) -> tuple[NDArray[np.int64], Array]:
        """Draw events for composites of (N, K, d) likelihood ratios to clutter, in random order.

        Returns:
            (N, K) as which detection each device is seen, -1 for none; and (N,) by how much log weights grow.
        """
        particles, devices, count = ratio.shape
        p, free = self._parameters, np.ones((particles, count), np.bool_)
        seen_as, grown = np.full((particles, devices), -1, np.int64), np.zeros(particles)
        examined = np.zeros(devices)
        for composite in self._rng.permutation(devices * count).tolist():
            device, sighting = divmod(composite, count)
            prior = p.detection
            if p.hazard:
                prior /= count - examined[device] * p.detection
            examined[device] += 1.0
            # The restrictions: who has been updated is not again, and a detection updates one.
            able = free[:, sighting] & (seen_as[:, device] < 0)
            event = np.where(able, prior * ratio[:, device, sighting], 0.0)
            total = event + np.where(able, 1.0 - prior, 1.0)
            taken = self._rng.random(particles) * total < event
            seen_as[taken, device], free[taken, sighting] = sighting, False
            grown += np.log(total)
        return seen_as, grown

    def _look(self, seen_as: NDArray[np.int64], sightings: Array, mean: Array, covariance: Array) -> None:
        """Update who was seen from (N, K, 2) and (N, K, 2, 2) after the scans; let others be born, be lost or age."""
        p, noise = self._parameters, _round(self._parameters.camera)
        seen = seen_as >= 0
        updated, born = np.nonzero(seen & self.alive), np.nonzero(seen & ~self.alive)
        if p.radio_only:
            self.mean, self.covariance = mean.copy(), covariance.copy()
        before = covariance[updated]
        gain = before @ np.linalg.inv(before + noise)
        self.mean[updated] = mean[updated] + np.einsum("uij,uj->ui", gain, sightings[seen_as[updated]] - mean[updated])
        self.covariance[updated] = before - gain @ before
        self.mean[born], self.covariance[born] = sightings[seen_as[born]], noise
        self._unseen = np.where(seen, 0, self._unseen + 1)
        self.alive = (self.alive | seen) & (self._unseen < p.death)

    def _estimate(self) -> Array:
        weight = self.weight[:, None] * self.alive
        share = weight.sum(axis=0)
        mean = np.einsum("nk,nki->ki", weight, self.mean) / np.maximum(share, 1e-300)[:, None]
        return np.where(share[:, None] > 0.5, mean, np.nan)


def _round(deviation: float) -> Array:
    return deviation**2 * np.eye(2)


def _gaussian(error: Array, covariance: Array) -> Array:
    """Return the log-densities (...) of errors (..., s) of (..., s, s) covariance."""
    misfit = np.einsum("...i,...ij,...j->...", error, np.linalg.inv(covariance), error)
    _, log_det = np.linalg.slogdet(2.0 * math.pi * covariance)
    density: Array = -0.5 * (misfit + log_det)
    return density
