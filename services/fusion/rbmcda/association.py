"""Who was seen? Composites of devices and sightings, and one draw of the whole assignment per particle.

A composite is a device's scan with one sighting [ravel-thesis §6.3]. Relative to clutter, whose density is normalised
by the radio (§6.5a), its likelihood is p_d N(sighting; device after its scan) / density of sightings: the scan
itself, which sits in every composite, counts once, elsewhere (§6.5c). With fixed identities a scan is a one-to-one
assignment, which is drawn device by device (§6.5b): nobody is updated twice, no sighting updates two (but as two
people merged in one box), a device takes only composites of its own, and there is one of each. The weight grows by
the sum over the events, whose draw is thereby exact.

A sighting that is linked to the cycle before has a place that is no surprise: it is compared with where a stranger
would have gone, not with clutter. What is left as evidence is whether it moves as the phone says."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Composites", "composites_of", "draw_assignment"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Composites:
    """The l pairs of a device and a sighting that are near enough in some particle, sorted by device.

    Attributes:
        sighting: (l,) which.
        start: (X + 1,) where each device's pairs begin.
        likelihood: (N, l) of the sighting, given the device and its scan, 1/m².
    """

    sighting: Indices
    start: Indices
    likelihood: Array


def composites_of(mean: Array, covariance: Array, places: Array, noise: Array, gate: float) -> Composites:
    """Form the composites.

    Args:
        mean: (2, N, X) positions.
        covariance: (2, 2, N, X).
        places: (d, 2) sightings.
        noise: (d, 2, 2).
        gate: standard deviations.
    """
    widest = np.sqrt(noise[:, [0, 1], [0, 1]].max(axis=0, initial=0.0))
    reach = gate * (np.sqrt(np.stack([covariance[0, 0], covariance[1, 1]])) + widest[:, None, None])
    # A few particles in which a device may be anywhere must not make composites of everything in all others.
    wide = reach.max(axis=0) > 3.0 * np.median(reach.max(axis=0), axis=0, keepdims=True) if len(places) else None
    near = _within(places, mean, reach)
    tight = near if wide is None else _within(places, mean, np.where(wide, -np.inf, reach))
    device, sighting = np.nonzero(near)
    likelihood = np.zeros((mean.shape[1], len(device)))
    close = np.flatnonzero(tight[device, sighting])
    likelihood[:, close] = _densities(
        mean[:, :, device[close]], covariance[:, :, :, device[close]], places[sighting[close]], noise[sighting[close]]
    )
    if wide is not None:
        far = np.flatnonzero(~tight[device, sighting])
        row, column = np.nonzero(wide[:, device[far]])
        pair = far[column]
        likelihood[row, pair] = _densities(
            mean[:, row, device[pair]],
            covariance[:, :, row, device[pair]],
            places[sighting[pair]],
            noise[sighting[pair]],
        )
    start = np.concatenate([[0], np.cumsum(near.sum(axis=1))])
    return Composites(sighting, start, likelihood)


def _within(places: Array, mean: Array, reach: Array) -> NDArray[np.bool_]:
    """Return (X, d) whether a sighting lies in the box around all particles' reaches."""
    low, high = (mean - reach).min(axis=1), (mean + reach).max(axis=1)
    near: NDArray[np.bool_] = (places >= low.T[:, None]).all(axis=2) & (places <= high.T[:, None]).all(axis=2)
    return near


def _densities(mean: Array, covariance: Array, place: Array, noise: Array) -> Array:
    """Return the densities of (k, 2) sightings of noise (k, 2, 2), given (2, ..., k) and (2, 2, ..., k) states."""
    xx = covariance[0, 0] + noise[:, 0, 0]
    xy = covariance[0, 1] + noise[:, 0, 1]
    yy = covariance[1, 1] + noise[:, 1, 1]
    dx, dy = place[:, 0] - mean[0], place[:, 1] - mean[1]
    determinant = xx * yy - xy * xy
    misfit = (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / determinant
    density: Array = np.exp(-0.5 * misfit) / (2.0 * math.pi * np.sqrt(determinant))
    return density


def draw_assignment(
    composites: Composites,
    detection: Array,
    in_view: Array,
    density: float,
    merged: float,
    linked: Array,
    switched: float,
    stranger: Array,
    order: Indices,
    uniform: Array,
) -> tuple[Indices, Array]:
    """Draw who was seen where.

    Args:
        composites: of N particles and X devices.
        detection: (X,) probability that a device in view is seen.
        in_view: (N, X) probability that it is in view.
        density: of sightings, 1/m².
        merged: probability that a sighting is two people's.
        linked: (N, X, d) whether the device was seen, in the cycle before, as who this sighting surely is.
        switched: probability that it is not, after all.
        stranger: (d,) density of a linked sighting if it is somebody else, 1/m².
        order: (X,) in which devices are drawn.
        uniform: (N, X) draws.

    Returns:
        (N, X) which sighting each device was seen as, -1 for none; and (N, X) by how much its draw makes log weights
            grow.
    """
    particles, devices = in_view.shape
    seen_as = np.full((particles, devices), -1, np.int64)
    free = np.ones((particles, len(stranger)))
    growth = np.empty((particles, devices))
    everyone = np.arange(particles)
    for device in order.tolist():
        begin, end = composites.start[device], composites.start[device + 1]
        mine = composites.sighting[begin:end]
        events = np.empty((particles, end - begin + 1))
        same = linked[:, device, mine]
        bound = same.any(axis=1, keepdims=True)
        loose = np.where(bound, switched, 1.0)
        events[:, :1] = loose * (1.0 - detection[device] * in_view[:, device, None])
        prior = np.where(same, (1.0 - switched) / stranger[mine], loose * (detection[device] / density))
        events[:, 1:] = prior * composites.likelihood[:, begin:end] * free[:, mine]
        levels = np.cumsum(events, axis=1)
        total = levels[:, -1]
        growth[:, device] = np.log(total)
        event = (levels[:, :-1] <= (uniform[:, device] * total)[:, None]).sum(axis=1)
        seen = event > 0
        chosen = mine[event[seen] - 1]
        seen_as[seen, device] = chosen
        free[everyone[seen], chosen] = merged
    return seen_as, growth
