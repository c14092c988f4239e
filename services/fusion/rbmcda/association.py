"""Who was seen? Composites of devices and sightings, and one draw of the whole assignment per particle.

A composite is a device's scan with one sighting [ravel-thesis §6.3]. Relative to clutter, whose density is normalised
by the radio (§6.5a), its likelihood is p_d N(sighting; device after its scan) / density of sightings: the scan
itself, which sits in every composite, counts once, elsewhere (§6.5c). With fixed identities a scan is a one-to-one
assignment, which is drawn device by device (§6.5b): nobody is updated twice, no sighting updates two (but as two
people merged in one box), a device takes only composites of its own, and there is one of each. The weight grows by
the sum over the events, whose draw is thereby exact.

A sighting that is linked to the cycle before has a place that is no surprise, and that others may be the same person
was weighed when the link was taken: weighed again each cycle, it would drive a device off whomever another thinks to
be. What is left as evidence is whether the person walked as the phone says, against how a stranger walks."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Composites", "composites_of", "draw_assignment", "linked_to"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

BLOCK = 16384
"""Pairs of a state and a sighting worked on at a time: few enough to stay in the processor's cache."""
OUTLYING = 3.0
"""Times as far as the median state reaches: such a state makes no composites for the others of its device."""


@dataclass(frozen=True)
class Composites:
    """The l sightings of which one device's u states make composites.

    Attributes:
        sighting: (l,) which, ascending.
        likelihood: (l, u) of each, given the state after the scan, 1/m².
    """

    sighting: Indices
    likelihood: Array


def composites_of(
    mean: Array, covariance: Array, start: Indices, places: Array, noise: Array, gate: float
) -> list[Composites]:
    """Form the composites of every device.

    Args:
        mean: (2, u) positions, by device.
        covariance: (2, 2, u).
        start: (X + 1,) where each device's states begin.
        places: (d, 2) sightings.
        noise: (d, 2, 2).
        gate: standard deviations.
    """
    if not len(places) or len(start) == 1:
        return [Composites(np.zeros(0, np.int64), np.zeros((0, count))) for count in np.diff(start).tolist()]
    widest = np.sqrt(noise[:, [0, 1], [0, 1]].max(axis=0))
    reach = gate * (np.sqrt(covariance[[0, 1], [0, 1]]) + widest[:, None])
    low, high = mean - reach, mean + reach
    farthest = reach.max(axis=0)
    # A few states in which a device may be anywhere must not make composites of everything in all others.
    owner = np.repeat(np.arange(len(start) - 1), np.diff(start))
    median = farthest[np.lexsort((farthest, owner))[(start[:-1] + start[1:]) // 2]]
    wide = farthest > OUTLYING * median[owner]
    near = _within(places, low, high, start)
    tight = _within(places, np.where(wide, np.inf, low), np.where(wide, -np.inf, high), start)
    composites = []
    for device, (begin, end) in enumerate(itertools.pairwise(start.tolist())):
        x, p, far = mean[:, begin:end], covariance[:, :, begin:end], wide[begin:end]
        sighting = near[device].nonzero()[0]
        close = tight[device, sighting]
        if close.all():
            likelihood = _densities(x, p, places[sighting], noise[sighting])
        else:
            mine, rest = sighting[close], sighting[~close]
            likelihood = np.zeros((len(sighting), end - begin))
            likelihood[close] = _densities(x, p, places[mine], noise[mine])
            likelihood[(~close)[:, None] & far] = _densities(x[:, far], p[:, :, far], places[rest], noise[rest]).ravel()
        composites.append(Composites(sighting, likelihood))
    return composites


def _within(places: Array, low: Array, high: Array, start: Indices) -> NDArray[np.bool_]:
    """Return (X, d) whether a sighting lies in the box around all reaches of a device, (2, u) ``low`` to ``high``."""
    lowest = np.minimum.reduceat(low, start[:-1], axis=1)[:, :, None]
    highest = np.maximum.reduceat(high, start[:-1], axis=1)[:, :, None]
    inside = (places.T[:, None] >= lowest) & (places.T[:, None] <= highest)
    near: NDArray[np.bool_] = inside[0] & inside[1]
    return near


def _densities(mean: Array, covariance: Array, places: Array, noise: Array) -> Array:
    """Return the densities (l, u) of sightings (l, 2) of noise (l, 2, 2), given (2, u) and (2, 2, u) states."""
    density = np.empty((len(places), mean.shape[1]))
    step = max(BLOCK // max(mean.shape[1], 1), 1)
    for begin in range(0, len(places), step):
        block = slice(begin, begin + step)
        xx = noise[block, 0, 0, None] + covariance[0, 0]
        xy = noise[block, 0, 1, None] + covariance[0, 1]
        yy = noise[block, 1, 1, None] + covariance[1, 1]
        dx, dy = places[block, 0, None] - mean[0], places[block, 1, None] - mean[1]
        determinant = xx * yy
        determinant -= xy * xy
        # (yy dx² − 2 xy dx dy + xx dy²) / determinant, in the arrays that are there.
        yy *= dx
        xy *= dy
        xy *= 2.0
        yy -= xy
        yy *= dx
        xx *= dy
        xx *= dy
        yy += xx
        yy /= determinant
        yy *= -0.5
        np.exp(yy, out=yy)
        np.sqrt(determinant, out=determinant)
        determinant *= 2.0 * math.pi
        np.divide(yy, determinant, out=density[block])
    return density


def draw_assignment(
    composites: Sequence[Composites],
    state: Indices,
    detection: Array,
    in_view: Array,
    density: float,
    merged: float,
    linked: Indices,
    switched: Array,
    favour: Array,
    pickup: Array,
    order: Indices,
    uniform: Array,
) -> tuple[Indices, Array]:
    """Draw who was seen where.

    Args:
        composites: of X devices.
        state: (N, X) which of its device's states each of N particles holds.
        detection: (X,) probability that a device in view is seen.
        in_view: (N, X) probability that it is in view.
        density: of sightings, 1/m².
        merged: probability that a sighting is two people's.
        linked: (N, X) which sighting surely is whom the device was seen as in the cycle before; -1 for none.
        switched: (d,) probability that it is not, after all.
        favour: (X, d) by what factor walks make it likelier that a device is who it was linked to.
        pickup: (d,) factor on the density at which a device that was not linked is taken for a sighting.
        order: (X,) in which devices are drawn.
        uniform: (N, X) draws.

    Returns:
        (N, X) which sighting each device was seen as, -1 for none; and (N, X) by how much its draw makes log weights
            grow.
    """
    particles, devices = state.shape
    seen_as = np.full((particles, devices), -1, np.int64)
    free = np.ones((len(pickup), particles))
    total = np.ones((particles, devices))
    place = np.empty(len(pickup) + 1, np.int64)
    for device in order.tolist():
        mine = composites[device].sighting
        place.fill(-1)
        place[mine] = np.arange(len(mine))
        partner = place[linked[:, device]]
        rows = np.flatnonzero(partner >= 0)
        same = mine[partner[rows]]
        loose = np.ones(particles)
        loose[rows] = switched[same]
        levels = np.empty((len(mine) + 1, particles))
        levels[0] = loose * (1.0 - detection[device] * in_view[:, device])
        events = levels[1:]
        np.take(composites[device].likelihood, state[:, device], axis=1, out=events, mode="clip")
        events *= free[mine]
        events *= pickup[mine, None]
        events *= loose * (detection[device] / density)
        events[partner[rows], rows] = (1.0 - switched[same]) * favour[device, same]
        np.cumsum(levels, axis=0, out=levels)
        total[:, device] = levels[-1]
        event = (levels[:-1] <= uniform[:, device] * levels[-1]).sum(axis=0)
        seen = np.flatnonzero(event)
        chosen = mine[event[seen] - 1]
        seen_as[seen, device] = chosen
        free[chosen, seen] = merged
    return seen_as, np.log(total)


def linked_to(links: Indices, sought: Indices) -> Indices:
    """Return at which place of (d,) ``links``, all different, each of ``sought`` is; -1 where it is not."""
    if not len(links):
        return np.full(sought.shape, -1, np.int64)
    order = np.argsort(links)
    place = order[np.minimum(np.searchsorted(links, sought, sorter=order), len(links) - 1)]
    found: Indices = np.where(links[place] == sought, place, -1)
    return found
