"""Who is where by sight alone, with many guesses at who was who: particles over constant-velocity filters.

Given its history of associations, everybody of a particle is an independent Kalman filter [ravel-thesis §6.1, Alg. 1;
§16], after Särkkä, Vehtari and Lampinen (2007). Detections only, nobody has a name.

A scan with M detections has, in a particle with T people, the probability of its association: (1 − p_d) per person not
seen, p_d N(y) per person seen, the density of clutter or of births for every other detection. Detections are taken in
random order; each draws its event from the exact conditional (the optimal importance density) and multiplies the
particle's weight by the sum over events. A person is seen once per scan at most, and dies unseen for a fixed time or
out of view.

The answer is the mixture: people born of the same detection are one person in all particles; whoever exists with
probability over one half is told, at the weighted mean over the particles that hold them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from services.fusion.positions.kalman_bank import innovations, predict, start, update
from services.fusion.snapshot import unpack

__all__ = ["Particles", "RbmcdaParameters", "View"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

NOBODY = -1
CLUTTER, BIRTH, FIRST_PERSON = 0, 1, 2
"""Columns of the table of events."""


@dataclass(frozen=True, slots=True)
class RbmcdaParameters:
    """The settings of the filter. N = 100 and the cycle are the original's, the rest it does not publish.

    Attributes:
        particles: number of association histories.
        cycle: seconds; the newest frame of each camera in it is used.
        detection: probability that somebody in view is detected in a frame.
        false_per_frame: detections of nobody.
        births_per_s: people who come into view.
        acceleration: white acceleration, m/s² in one second [ravel-thesis §16].
        speed: standard deviation of a new person's velocity along each axis, m/s.
        death: seconds unseen after which a person is gone.
        margin: metres outside the view at which a person is gone.
        seed: of all draws.
    """

    particles: int = 100
    cycle: float = 1.0
    detection: float = 0.7
    false_per_frame: float = 0.5
    births_per_s: float = 0.05
    acceleration: float = 0.6
    speed: float = 1.0
    death: float = 10.0
    margin: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse settings without a meaning."""
        for name in ("particles", "cycle", "false_per_frame", "births_per_s", "acceleration", "speed", "death"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: {getattr(self, name)} is not allowed; it must be positive")
        if not 0.0 < self.detection < 1.0:
            raise ValueError(f"detection: {self.detection} is not allowed; it must be between 0 and 1")


class View:
    """The floor that is watched.

    Args:
        corners: (c, 2) metres, of the convex view.

    Attributes:
        area: m².
    """

    def __init__(self, corners: Array) -> None:
        hull = ConvexHull(corners)
        self.area = float(hull.volume)
        self._normals: Array = hull.equations[:, :2]
        self._offsets: Array = hull.equations[:, 2]

    def holds(self, positions: Array, margin: float) -> NDArray[np.bool_]:
        """Return whether places (…, 2) lie in view or at most ``margin`` metres out of it (more at its corners)."""
        inside: NDArray[np.bool_] = (positions @ self._normals.T + self._offsets).max(axis=-1) <= margin
        return inside


class Particles:
    """The association histories of N particles and the people in each, as arrays over (particle, place).

    Args:
        view: of the cameras.
        parameters: of the filter.

    Attributes:
        weight: (N,), summing to one; of the last scan, before resampling.
        identity: (N, P) who is at each place, ids shared by particles; -1 for nobody.
        mean: (N, P, 4) x, y, vx, vy.
        covariance: (N, P, 4, 4).
        generator: of all draws.
    """

    def __init__(self, view: View, parameters: RbmcdaParameters) -> None:
        self._view = view
        self._parameters = parameters
        self.generator = np.random.default_rng(parameters.seed)
        self._t: float | None = None
        self._born = 0
        n, places = parameters.particles, 4
        self.weight: Array = np.full(n, 1.0 / n)
        self.identity: Indices = np.full((n, places), NOBODY, np.int64)
        self.mean: Array = np.zeros((n, places, 4))
        self.covariance: Array = np.zeros((n, places, 4, 4))
        self._seen: Array = np.zeros((n, places))
        self._people: tuple[Indices, Array] = (np.zeros(0, np.int64), np.zeros((0, 4)))

    def scan(self, t: float, positions: Array, noise: Array) -> None:
        """Take in the detections of one cycle.

        Args:
            t: seconds, not decreasing.
            positions: (m, 2), metres.
            noise: (m, 2, 2), m².
        """
        chosen = self._parameters
        self._predict(t)
        self._t = t
        alive = self.identity != NOBODY
        log_weight = np.log(self.weight) + alive.sum(axis=1) * math.log1p(-chosen.detection)
        log_weight += self._associate(t, alive, positions, noise)
        weight = np.exp(log_weight - log_weight.max())
        self.weight = weight / weight.sum()
        self._people = self._mixture()
        self._told, self._told_weight = self.identity, self.weight
        self._told_mean, self._told_spread = self.mean[:, :, :2], self.covariance[:, :, :2, :2]
        if 1.0 / float(self.weight @ self.weight) < 0.5 * chosen.particles:
            self._resample()

    def people(self) -> tuple[Indices, Array]:
        """Return ids (p,) and weighted mean states (p, 4) of who exists with probability over one half."""
        return self._people

    def covariances(self) -> Array:
        """Return (p, 2, 2), m², of the positions of those people, with the spread over particles."""
        ids, states = self._people
        spread = np.zeros((len(ids), 2, 2))
        for row, (who, state) in enumerate(zip(ids, states, strict=True)):
            particle, place = np.nonzero(self._told == who)
            weight = self._told_weight[particle]
            apart = self._told_mean[particle, place] - state[:2]
            spread[row] = np.einsum("k,kij->ij", weight, self._told_spread[particle, place])
            spread[row] = (spread[row] + np.einsum("k,ki,kj->ij", weight, apart, apart)) / weight.sum()
        return spread

    def seen_last(self, who: int) -> float:
        """Return when somebody was last seen in the particle that saw them last."""
        return float(self._seen[self.identity == who].max(initial=-math.inf))

    def state(self) -> dict[str, Any]:
        """Return a copy of all that is known, but for the generator."""
        return {"t": self._t, "born": self._born, **{name: getattr(self, name).copy() for name in _ARRAYS}}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state()``."""
        arrays = {name: unpack(state[name]) for name in _ARRAYS}
        self._t, self._born = state["t"], int(state["born"])
        for name, array in arrays.items():
            setattr(self, name, array)

    def _predict(self, t: float) -> None:
        chosen = self._parameters
        n, places = self.identity.shape
        if self._t is not None and t > self._t:
            mean, covariance = self.mean.reshape(-1, 4), self.covariance.reshape(-1, 4, 4)
            predict(mean, covariance, t - self._t, chosen.acceleration**2)
            self.mean, self.covariance = mean.reshape(n, places, 4), covariance.reshape(n, places, 4, 4)
        gone = (t - self._seen > chosen.death) | ~self._view.holds(self.mean[:, :, :2], chosen.margin)
        self.identity[gone] = NOBODY

    def _associate(self, t: float, alive: NDArray[np.bool_], positions: Array, noise: Array) -> Array:
        """Draw what each detection is, update who was seen, and return by how much the log weights grow, (N,)."""
        chosen = self._parameters
        n = chosen.particles
        everyone = np.arange(n)
        seen_as = np.full(self.identity.shape, NOBODY, np.int64)
        free = alive.copy()
        likelihood = self._likelihood(alive, positions, noise)
        growth = np.zeros(n)
        for detection in self.generator.permutation(len(positions)):
            events = np.empty((n, FIRST_PERSON + self.identity.shape[1]))
            events[:, CLUTTER] = chosen.false_per_frame / self._view.area
            events[:, BIRTH] = chosen.births_per_s * chosen.cycle / self._view.area
            events[:, FIRST_PERSON:] = np.where(free, likelihood[:, :, detection], 0.0)
            levels = np.cumsum(events, axis=1)
            growth += np.log(levels[:, -1])
            event = (levels <= (self.generator.random(n) * levels[:, -1])[:, None]).sum(axis=1)
            who = everyone[event >= FIRST_PERSON]
            place = event[who] - FIRST_PERSON
            free[who, place] = False
            seen_as[who, place] = detection
            mothers = everyone[event == BIRTH]
            if len(mothers) and self._bear(mothers, t, detection, positions[detection], noise[detection]):
                wider = ((0, 0), (0, self.identity.shape[1] - free.shape[1]))
                free, seen_as = np.pad(free, wider), np.pad(seen_as, wider, constant_values=NOBODY)
                likelihood = np.pad(likelihood, (*wider, (0, 0)))
        self._born += len(positions)
        who, place = np.nonzero(seen_as != NOBODY)
        if len(who):
            of = seen_as[who, place]
            self.mean[who, place], self.covariance[who, place] = update(
                self.mean[who, place], self.covariance[who, place], positions[of], noise[of]
            )
            self._seen[who, place] = t
        return growth

    def _likelihood(self, alive: NDArray[np.bool_], positions: Array, noise: Array) -> Array:
        """Return p_d / (1 − p_d) N(detection; person), (N, P, m), in 1/m²; zero for nobody."""
        odds = self._parameters.detection / (1.0 - self._parameters.detection)
        result = np.zeros((*alive.shape, len(positions)))
        if alive.any() and len(positions):
            _, distance, log_determinant = innovations(self.mean[alive], self.covariance[alive], positions, noise)
            result[alive] = odds / (2.0 * math.pi) * np.exp(-0.5 * (distance + log_determinant))
        return result

    def _bear(self, mothers: Indices, t: float, detection: int, position: Array, noise: Array) -> bool:
        """Put a new person into the first empty place of each particle; say whether places had to be added."""
        empty = self.identity[mothers] == NOBODY
        full = not empty.any(axis=1).all()
        if full:
            n, places = self.identity.shape
            self.identity = np.concatenate([self.identity, np.full((n, places), NOBODY)], axis=1)
            self.mean = np.concatenate([self.mean, np.zeros((n, places, 4))], axis=1)
            self.covariance = np.concatenate([self.covariance, np.zeros((n, places, 4, 4))], axis=1)
            self._seen = np.concatenate([self._seen, np.zeros((n, places))], axis=1)
            empty = self.identity[mothers] == NOBODY
        place = empty.argmax(axis=1)
        mean, covariance = start(position[None], noise[None], self._parameters.speed)
        self.identity[mothers, place] = self._born + detection
        self.mean[mothers, place] = mean[0]
        self.covariance[mothers, place] = covariance[0]
        self._seen[mothers, place] = t
        return full

    def _mixture(self) -> tuple[Indices, Array]:
        particle, place = np.nonzero(self.identity != NOBODY)
        ids, who = np.unique(self.identity[particle, place], return_inverse=True)
        weight = self.weight[particle]
        exists = np.bincount(who, weight, len(ids))
        states = np.stack(
            [np.bincount(who, weight * axis, len(ids)) for axis in self.mean[particle, place].T], axis=1
        )  # fmt: skip
        likely = exists > 0.5
        return ids[likely], states[likely] / exists[likely, None]

    def _resample(self) -> None:
        """Systematic resampling; people whom no particle holds any more are forgotten with their particles."""
        n = self._parameters.particles
        levels = np.cumsum(self.weight)
        levels[-1] = 1.0
        chosen = np.searchsorted(levels, (self.generator.random() + np.arange(n)) / n, side="right")
        self.identity, self._seen = self.identity[chosen], self._seen[chosen]
        self.mean, self.covariance = self.mean[chosen], self.covariance[chosen]
        self.weight = np.full(n, 1.0 / n)


_ARRAYS = ("weight", "identity", "mean", "covariance", "_seen")
