"""What the identity filter holds from cycle to cycle, what a cycle brings, and what it says [ravel-thesis §6.1].

The filter of a device follows from its history alone, and particles drawn from the same one share it until they see
the device as different people: each state is kept once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

__all__ = ["Cycle", "Draws", "Estimate", "Particles"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

NEIGHBOUR = 0.5
"""Metres over which the slope of what is expected is taken."""


@dataclass(frozen=True)
class Particles:
    """N association histories of X devices with M access points; the state is S = 2 + M long.

    Attributes:
        weight: (N, X), summing to one for each device.
        mean: (S, U) position in metres, then biases in dB, of U states, the first device's first.
        covariance: (S, S, U).
        state: (N, X) which of them each particle holds.
        fed: (N, X) whether a camera saw the device in the last cycle.
        seen: (N, X) when one last did, seconds; -inf for never.
        link: (N, X) as whom it saw it, while that is followed; -1 for nobody.
    """

    weight: Array
    mean: Array
    covariance: Array
    state: Indices
    fed: NDArray[np.bool_]
    seen: Array
    link: Indices

    @classmethod
    def empty(cls, particles: int, access_points: int) -> Particles:
        """Return particles without devices."""
        size = 2 + access_points
        return cls(
            weight=np.zeros((particles, 0)),
            mean=np.zeros((size, 0)),
            covariance=np.zeros((size, size, 0)),
            state=np.zeros((particles, 0), np.int64),
            fed=np.zeros((particles, 0), np.bool_),
            seen=np.zeros((particles, 0)),
            link=np.zeros((particles, 0), np.int64),
        )

    def with_device(self, mean: Array, covariance: Array) -> Particles:
        """Return them with one more device, out of view: (S,) and (S, S), the same in all particles."""
        count = len(self.weight)
        return Particles(
            weight=np.concatenate([self.weight, np.full((count, 1), 1.0 / count)], axis=1),
            mean=np.concatenate([self.mean, mean[:, None]], axis=1),
            covariance=np.concatenate([self.covariance, covariance[:, :, None]], axis=2),
            state=np.concatenate([self.state, np.full((count, 1), self.mean.shape[1])], axis=1),
            fed=np.concatenate([self.fed, np.zeros((count, 1), np.bool_)], axis=1),
            seen=np.concatenate([self.seen, np.full((count, 1), -np.inf)], axis=1),
            link=np.concatenate([self.link, np.full((count, 1), -1)], axis=1),
        )

    def without(self, device: int) -> Particles:
        """Return them without one device, nor any state of it: it may have asked to be forgotten."""
        kept = np.delete(self.state, device, axis=1)
        held, state = np.unique(kept, return_inverse=True)
        return replace(
            self,
            weight=np.delete(self.weight, device, axis=1),
            mean=self.mean[:, held],
            covariance=self.covariance[:, :, held],
            state=state.reshape(kept.shape),
            fed=np.delete(self.fed, device, axis=1),
            seen=np.delete(self.seen, device, axis=1),
            link=np.delete(self.link, device, axis=1),
        )

    def retuned(self, less: Callable[[Array], Array]) -> Particles:
        """Return them under another radio model: what was heard is the same, so biases take up what models differ by.

        To first order about each state, so that where it may be and what it then hears stay tied together.

        Args:
            less: from places (n, 2) to by how much the new model expects less than the old one, (n, M) dB.
        """
        places = self.mean[:2].T
        mean, covariance = self.mean.copy(), self.covariance.copy()
        mean[2:] += less(places).T
        for axis in (0, 1):
            step = np.eye(2)[axis] * NEIGHBOUR
            slope = ((less(places + step) - less(places - step)) / (2.0 * NEIGHBOUR)).T
            covariance[2:] += slope[:, None] * covariance[axis]
            covariance[:, 2:] += slope * covariance[:, axis, None]
        return replace(self, mean=mean, covariance=covariance)

    def redraw(self, rows: Indices, devices: Indices) -> None:
        """Let the particles of (k,) ``devices`` go on from (N, k) ``rows``, all alike likely."""
        self.weight[:, devices] = 1.0 / len(rows)
        self.state[:, devices] = self.state[rows, devices]
        self.fed[:, devices] = self.fed[rows, devices]
        self.seen[:, devices] = self.seen[rows, devices]
        self.link[:, devices] = self.link[rows, devices]

    def positions(self) -> tuple[Array, Array]:
        """Return (2, N, X) means and (2, 2, N, X) covariances of positions, metres and m²."""
        return self.mean[:2, self.state], self.covariance[:2, :2][:, :, self.state]


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
        link: (d,) numbers, all different, that a sighting keeps from cycle to cycle while it is surely the same person.
        switched: (d,) probability that the person seen is not who the link says.
        favour: (X, d) by what factor walks make it likelier that a device is on a link.
        pickup: (d,) factor on the density at which a device on no link is taken for a sighting.
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
    switched: Array
    favour: Array
    pickup: Array
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

    def finite(self) -> NDArray[np.bool_]:
        """Return of which devices (X,) all is a number."""
        total: Array = self.mean.sum(axis=0) + self.covariance.sum(axis=(0, 1)) + self.biases.sum(axis=0)
        return np.isfinite(total)

    def of_devices(self, kept: NDArray[np.bool_]) -> Estimate:
        """Return it for some of the devices only."""
        return Estimate(*(getattr(self, field.name)[..., kept] for field in fields(self)))
