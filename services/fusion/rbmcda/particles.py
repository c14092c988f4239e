"""One cycle of the identity filter, as arrays over (state, particle, device) [ravel-thesis §6.4, Alg. 2].

Each particle is a history of who was seen where; given it, every device is an unscented filter of its position and of
what the radio of each access point is off for it. The bias makes the original's *untrained models* bearable:
constants of access points and phones, and shadowing, are unknown by several dB, the same from scan to scan; as part
of the state they are learned while a camera sees the device and are no new evidence the second time.

Every device of the filter exists in every particle, in view or not. One that is out of view is moved by its steps and
its scans alone; to be born on a sighting, or found again, is the same event as to be seen once more, with a wider
Gaussian. So nobody has to be born on a stranger because their phone is heard.

Pure: the draws are handed in..
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from services.fusion.rbmcda.association import composites_of, draw_assignment
from services.fusion.rbmcda.resampling import effective, systematic
from services.fusion.rbmcda.settings import RbmcdaSettings
from services.fusion.rbmcda.unscented import MEAN_WEIGHTS, camera_update, radio_update, sigma_points

__all__ = ["Cycle", "Draws", "Estimate", "Particles", "run_cycle"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

KNOWN = 1.0
"""m²; forces are for those whose place is known to within a metre."""
LEAST = 1e-300
"""Weight that stands for none."""


@dataclass(frozen=True)
class Particles:
    """N association histories of X devices with M access points; the state is S = 2 + M long.

    Attributes:
        weight: (N, X), summing to one for each device.
        mean: (S, N, X) position in metres, then biases in dB.
        covariance: (S, S, N, X).
        fed: (N, X) whether a camera saw the device in the last cycle.
        seen: (N, X) when one last did, seconds; -inf for never.
        link: (N, X) as whom it saw it, while that is followed; -1 for nobody.
    """

    weight: Array
    mean: Array
    covariance: Array
    fed: NDArray[np.bool_]
    seen: Array
    link: Indices

    @classmethod
    def empty(cls, particles: int, access_points: int) -> Particles:
        """Return particles without devices."""
        size = 2 + access_points
        return cls(
            weight=np.zeros((particles, 0)),
            mean=np.zeros((size, particles, 0)),
            covariance=np.zeros((size, size, particles, 0)),
            fed=np.zeros((particles, 0), np.bool_),
            seen=np.zeros((particles, 0)),
            link=np.zeros((particles, 0), np.int64),
        )

    def with_device(self, mean: Array, covariance: Array) -> Particles:
        """Return them with one more device, out of view: (S,) and (S, S), the same in all particles."""
        count = len(self.weight)
        weight = np.full((count, 1), 1.0 / count)
        return replace(
            self,
            weight=np.concatenate([self.weight, weight], axis=1),
            mean=np.concatenate([self.mean, np.broadcast_to(mean[:, None, None], (len(mean), count, 1))], axis=2),
            covariance=np.concatenate(
                [
                    self.covariance,
                    np.broadcast_to(covariance[:, :, None, None], (len(mean), len(mean), count, 1)),
                ],
                axis=3,
            ),
            fed=np.concatenate([self.fed, np.zeros((count, 1), np.bool_)], axis=1),
            seen=np.concatenate([self.seen, np.full((count, 1), -np.inf)], axis=1),
            link=np.concatenate([self.link, np.full((count, 1), -1)], axis=1),
        )

    def without(self, device: int) -> Particles:
        """Return them without one device."""
        return replace(
            self,
            weight=np.delete(self.weight, device, axis=1),
            mean=np.delete(self.mean, device, axis=2),
            covariance=np.delete(self.covariance, device, axis=3),
            fed=np.delete(self.fed, device, axis=1),
            seen=np.delete(self.seen, device, axis=1),
            link=np.delete(self.link, device, axis=1),
        )

    def redraw(self, rows: Indices, devices: Indices) -> None:
        """Let the particles of (k,) ``devices`` go on from (N, k) ``rows``, all alike likely."""
        self.weight[:, devices] = 1.0 / len(rows)
        self.mean[:, :, devices] = self.mean[:, rows, devices]
        self.covariance[:, :, :, devices] = self.covariance[:, :, rows, devices]
        self.fed[:, devices] = self.fed[rows, devices]
        self.seen[:, devices] = self.seen[rows, devices]
        self.link[:, devices] = self.link[rows, devices]


@dataclass(frozen=True)
class Cycle:
    """What came in between the last cycle and this one, for X devices.

    Attributes:
        t: the time of the cycle, seconds.
        shift: (2, X) metres walked.
        owed: (2, X) metres by which the last cycle's guess was wrong.
        spread: (2, 2, X) m², of ``shift``.
        haste: (X,) m² along each axis, of the part of ``shift`` that is a guess.
        kept: (X,) how much of the biases remains, from 0 to 1.
        usual: (M,) dB, the biases of phones in the mean.
        bias: (M, M) dB², of biases about it of which nothing is known.
        reading: (M, X) dBm; NaN where not heard.
        noise: (M, X) dB².
        expected: from places (n, 2) to signal strengths (n, M).
        places: (d, 2) sightings.
        place_noise: (d, 2, 2) m².
        link: (d,) numbers that a sighting keeps from cycle to cycle while it is surely the same person.
        stranger: (d,) density of each place if its link is somebody else's, 1/m².
        detection: (X,) probability that a device in view is seen.
        in_view: from places (n, 2) to how surely they are in the view of a camera that looked, (n,).
        density: of sightings, 1/m².
        anew: by device, the state (S,) and (S, S) of a device of which nothing is known but this scan, and the scan's
            log-likelihood.
        push: from (2, N, X) positions and (N, X) who is known to be there to (2, N, X) metres and (2, 2, N, X), the
            Jacobian of the prediction; None: no
            forces.
    """

    t: float
    shift: Array
    owed: Array
    spread: Array
    haste: Array
    kept: Array
    usual: Array
    bias: Array
    reading: Array
    noise: Array
    expected: Callable[[Array], Array]
    places: Array
    place_noise: Array
    link: Indices
    stranger: Array
    detection: Array
    in_view: Callable[[Array], Array]
    density: float
    anew: Mapping[int, tuple[Array, Array, float]]
    push: Callable[[Array, NDArray[np.bool_]], tuple[Array, Array]] | None = None


@dataclass(frozen=True)
class Draws:
    """The random numbers of a cycle: an order of the devices (X,), and uniforms.

    Attributes:
        order: (X,) in which devices take sightings.
        uniform: (N, X) what each is seen as.
        jump: (N, X) whether it may be anywhere.
        resampling: (X,).
    """

    order: Indices
    uniform: Array
    jump: Array
    resampling: Array

    @classmethod
    def of(cls, generator: np.random.Generator, particles: int, devices: int) -> Draws:
        """Draw them."""
        size = (particles, devices)
        order = generator.permutation(devices)
        return cls(order, generator.random(size), generator.random(size), generator.random(devices))


@dataclass(frozen=True)
class Estimate:
    """The mixture of a cycle [ravel-thesis §6.1], per device.

    Attributes:
        mean: (2, X) metres.
        covariance: (2, 2, X), with the spread over particles.
        biases: (M, X) dB.
        fed: (X,) probability that a camera saw it in this cycle.
        seen: (X,) mean time at which one last did, of the particles in which one did; -inf where none.
        agreed: (X,) share of the weight that lies within a metre of the mean.
        seen_as: (N, X) sightings, and
        weight: (N, X), of the particles before they were drawn anew.
    """

    mean: Array
    covariance: Array
    biases: Array
    fed: Array
    seen: Array
    agreed: Array
    seen_as: Indices
    weight: Array


def run_cycle(before: Particles, cycle: Cycle, settings: RbmcdaSettings, draws: Draws) -> tuple[Particles, Estimate]:
    """Predict, take in scans and sightings, weigh, estimate, and draw the particles anew where too few count."""
    mean, covariance = _predict(before, cycle)
    seen_as = np.full(before.fed.shape, -1, np.int64)
    growth = np.zeros(before.fed.shape)
    heard = np.flatnonzero(np.isfinite(cycle.reading).any(axis=0))
    predicted = (mean, covariance) if not settings.radio_only else None
    if len(heard):
        mean, covariance = mean.copy(), covariance.copy()
        particles = len(before.weight)
        mean[:, :, heard], covariance[:, :, :, heard], growth[:, heard] = radio_update(
            mean[:, :, heard],
            covariance[:, :, :, heard],
            cycle.expected,
            np.repeat(cycle.reading[:, None, heard], particles, axis=1),
            np.repeat(cycle.noise[:, None, heard], particles, axis=1),
        )
    link = before.link.copy()
    for device, (fresh_mean, fresh_covariance, fresh_evidence) in cycle.anew.items():
        rows = draws.jump[:, device] < settings.jump
        mean[:, rows, device] = fresh_mean[:, None]
        covariance[:, :, rows, device] = fresh_covariance[:, :, None]
        growth[rows, device] = fresh_evidence
        link[rows, device] = -1
    hasty = covariance[:2, :2].copy()
    hasty[0, 0] += cycle.haste
    hasty[1, 1] += cycle.haste
    if before.fed.shape[1]:
        composites = composites_of(mean[:2], hasty, cycle.places, cycle.place_noise, settings.gate)
        seen_as, drawn = draw_assignment(
            composites,
            cycle.detection,
            _view_share(mean, hasty, cycle.in_view),
            cycle.density,
            settings.merged,
            link[:, :, None] == cycle.link,
            settings.switched,
            cycle.stranger,
            draws.order,
            draws.uniform,
        )
        growth += drawn
    fed = seen_as >= 0
    link = np.where(fed, np.append(cycle.link, -1)[seen_as], -1)
    if predicted is not None and len(heard):
        mean, covariance = np.where(fed, mean, predicted[0]), np.where(fed, covariance, predicted[1])
    if fed.any():
        chosen = seen_as[fed]
        joined = covariance[:, :, fed]
        joined[:2, :2] = hasty[:, :, fed]
        mean[:, fed], covariance[:, :, fed] = camera_update(
            mean[:, fed],
            joined,
            cycle.places[chosen].T,
            np.moveaxis(cycle.place_noise[chosen], 0, -1),
        )
    weight = before.weight
    if not settings.separate:
        weight = np.broadcast_to(weight[:, :1], weight.shape)
        growth = np.broadcast_to(growth.sum(axis=1, keepdims=True), growth.shape)
    log_weight = np.log(np.maximum(weight, LEAST)) + growth
    weight = np.exp(log_weight - log_weight.max(axis=0, initial=-np.inf))
    weight /= weight.sum(axis=0)
    after = Particles(weight, mean, covariance, fed, np.where(fed, cycle.t, before.seen), link)
    estimate = _estimate(after, cycle, seen_as)
    poor = np.flatnonzero(effective(weight) < settings.resample_below * len(weight))
    if len(poor):
        lots = draws.resampling if settings.separate else np.full_like(draws.resampling, draws.resampling[0])
        after.redraw(systematic(weight[:, poor], lots[poor]), poor)
    return after, estimate


def _predict(before: Particles, cycle: Cycle) -> tuple[Array, Array]:
    """Return the states after the motion of the cycle (eq. 4.2, 4.12)."""
    mean, covariance = before.mean.copy(), before.covariance.copy()
    # Who was seen at the end of the last cycle was where the camera said, whatever had been guessed.
    mean[:2] += np.where(before.fed, 0.0, cycle.owed[:, None, :])
    if cycle.push is not None:
        shift, slope = cycle.push(mean[:2], covariance[0, 0] + covariance[1, 1] < KNOWN)
        mean[:2] += shift
        covariance[:2] = np.einsum("ijnx,jsnx->isnx", slope, covariance[:2])
        covariance[:, :2] = np.einsum("ijnx,sjnx->sinx", slope, covariance[:, :2])
    mean[:2] += cycle.shift[:, None, :]
    covariance[:2, :2] += cycle.spread[:, :, None, :]
    usual = cycle.usual[:, None, None]
    mean[2:] = usual + (mean[2:] - usual) * cycle.kept
    covariance[2:] *= cycle.kept
    covariance[:, 2:] *= cycle.kept
    covariance[2:, 2:] += cycle.bias[:, :, None, None] * (1.0 - cycle.kept**2)
    return mean, covariance


def _view_share(mean: Array, covariance: Array, in_view: Callable[[Array], Array]) -> Array:
    """Return (N, X) how probably each device is in view."""
    points = sigma_points(mean[:2], covariance)
    inside = in_view(np.moveaxis(points, 1, -1).reshape(-1, 2)).reshape(5, *mean.shape[1:])
    share: Array = np.tensordot(np.array(MEAN_WEIGHTS), inside, axes=1)
    return share


def _estimate(after: Particles, cycle: Cycle, seen_as: Indices) -> Estimate:
    weight = after.weight
    mean = np.einsum("nx,inx->ix", weight, after.mean[:2])
    apart = after.mean[:2] - mean[:, None, :]
    covariance = np.einsum("nx,ijnx->ijx", weight, after.covariance[:2, :2])
    covariance += np.einsum("nx,inx,jnx->ijx", weight, apart, apart)
    fed = (weight * after.fed).sum(axis=0)
    covariance[[0, 1], [0, 1]] += cycle.haste * (1.0 - fed)
    ever = np.isfinite(after.seen)
    share = (weight * ever).sum(axis=0)
    times = (weight * np.where(ever, after.seen - cycle.t, 0.0)).sum(axis=0)
    seen = np.where(share > 0.5, cycle.t + times / np.maximum(share, 0.5), -np.inf)
    agreed = (weight * (apart[0] ** 2 + apart[1] ** 2 < 1.0)).sum(axis=0)
    biases = np.einsum("nx,mnx->mx", weight, after.mean[2:])
    return Estimate(mean, covariance, biases, fed, seen, np.minimum(agreed, 1.0), seen_as, weight.copy())
