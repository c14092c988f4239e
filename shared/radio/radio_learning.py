"""Learn access points' constants and shadowing together, from readings at known places: a Gaussian process per point.

What an access point reads beyond the first guess of its path loss, the phone's own offset taken off, is

    (error of P₀) − (error of n) · 10 log₁₀ distance + shadowing of the place + white noise,

with shadowing correlated as exp(−distance / range) (Gudmundson, 1991). All of it is Gaussian, so one solve gives the
constants [ravel-thesis §8.4, with a prior], the map, and how sure it is. Readings are gathered in the cells of a grid,
which bounds memory and time; a cell holds weights and weighted sums, so it can be added to and faded at any time.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from shared.radio.path_loss import PathLoss
from shared.radio.radio_model import RadioModel
from shared.radio.shadowing_map import ShadowingMap

__all__ = ["RadioLearner", "RadioPrior", "device_offsets", "novelty"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_CELLS = 4000
"""Of a map; a large floor gets larger cells."""
MOST_PAIRS = 2000
"""Of phone and cell that one access point's readings are averaged into to compare phones; more get larger cells."""
LEAST_WEIGHT = 1e-6
"""dB⁻²; a cell that has faded below says nothing any more."""
FADED = 0.25
"""Metres a phone moves until what it reads is news."""
STILL = 0.1
"""How much one more reading of a phone at rest counts: people around it move."""


@dataclass(frozen=True)
class RadioPrior:
    """What is believed before any reading; standard deviations.

    Attributes:
        power: of P₀ about the first guess, dB; ``exponent`` likewise of n.
        exponent: see above.
        shadowing: dB, ``shadowing_range``: metres.
        shadowing_range: see above.
        white: from reading to reading, dB.
        device: of phones' offsets, dB.
    """

    power: float = 4.0
    exponent: float = 0.25
    shadowing: float = 4.0
    shadowing_range: float = 3.0
    white: float = 2.5
    device: float = 3.0

    def correlation(self, first: Array, second: Array) -> Array:
        """Return the covariance of shadowing, (n, k) in dB², between (n, 2) and (k, 2) places."""
        apart = np.hypot(*(first[:, None] - second[None]).transpose(2, 0, 1))
        covariance: Array = self.shadowing**2 * np.exp(-apart / self.shadowing_range)
        return covariance

    def constants(self, first: Array, second: Array) -> Array:
        """Return the covariance, (n, k) in dB², of what is off by the constants at two lists of log-distances."""
        covariance: Array = self.power**2 + self.exponent**2 * first[:, None] * second[None]
        return covariance

    def noise(self, spread: Array) -> Array:
        """Return the variance of a reading, (n,) in dB², taken at a place known to within ``spread`` (n,) metres.

        A place that is off by some metres reads the shadowing of another one.
        """
        variance: Array = self.white**2 + 2.0 * self.shadowing**2 * (1.0 - np.exp(-spread / self.shadowing_range))
        return variance


@dataclass
class RadioLearner:
    """Readings of m access points, gathered in the c = rows x columns cells of a grid.

    Attributes:
        guess: the first guess, from which residuals are taken.
        origin: (2,), centre of the first cell, metres.
        cell: side of a cell, metres.
        shape: rows and columns.
        prior: see ``RadioPrior``.
        weight: (m, c), inverse variance of the cell's mean, dB⁻².
        level: (m, c), weight times residual.
        place: (m, c, 2), weight times place.
    """

    guess: PathLoss
    origin: Array
    cell: float
    shape: tuple[int, int]
    prior: RadioPrior
    weight: Array
    level: Array
    place: Array

    @classmethod
    def over(
        cls, guess: PathLoss, lower: Array, upper: Array, cell: float = 1.0, prior: RadioPrior | None = None
    ) -> RadioLearner:
        """Return a learner that knows nothing, of the rectangle from ``lower`` to ``upper``, (2,) metres each."""
        cell = max(cell, math.sqrt(float(np.prod(upper - lower)) / MOST_CELLS))
        columns, rows = (max(1, math.ceil(extent / cell)) for extent in upper - lower)
        shape = (len(guess.names), rows * columns)
        return cls(
            guess=guess,
            origin=np.asarray(lower, float) + 0.5 * cell,
            cell=cell,
            shape=(rows, columns),
            prior=prior or RadioPrior(),
            weight=np.zeros(shape),
            level=np.zeros(shape),
            place=np.zeros((*shape, 2)),
        )

    def learn(self, places: Array, spread: Array, point: Index, residual: Array, share: Array) -> None:
        """Take in n readings; of which anything is not finite is left out.

        Args:
            places: (n, 2), where they were taken, metres; outside the grid they count to the nearest cell.
            spread: (n,), how exactly the place is known, metres.
            point: (n,), which access point.
            residual: (n,), heard − guess − the phone's own offset, dB.
            share: (n,), how much of a reading each is, 0 to 1 (see ``novelty``).
        """
        fine = np.isfinite(np.column_stack([places, spread, residual, share])).all(axis=1)
        places, spread, point = places[fine], spread[fine], point[fine]
        residual, share = residual[fine], share[fine]
        self.add(places, point, residual, share / self.prior.noise(spread))

    def add(self, places: Array, point: Index, residual: Array, weight: Array) -> None:
        """Take in n readings, or means of readings, as ``learn`` does; ``weight``: (n,) inverse variance, dB⁻²."""
        rows, columns = self.shape
        spot = np.rint((places - self.origin) / self.cell).astype(np.int64)
        x, y = np.clip(spot[:, 0], 0, columns - 1), np.clip(spot[:, 1], 0, rows - 1)
        where = (point, y * columns + x)
        np.add.at(self.weight, where, weight)
        np.add.at(self.level, where, weight * residual)
        np.add.at(self.place, where, weight[:, None] * places)

    def fade(self, kept: float) -> None:
        """Let everything learned count for ``kept`` (0 to 1) of what it did: the world changes."""
        self.weight *= kept
        self.level *= kept
        self.place *= kept

    def centres(self) -> Array:
        """Return the centres (c, 2) of the cells, metres."""
        columns, rows = np.meshgrid(np.arange(self.shape[1]), np.arange(self.shape[0]))
        return self.origin + self.cell * np.column_stack([columns.ravel(), rows.ravel()])

    def solve(self, site: str = "") -> RadioModel:
        """Return the model of all that was learned; ``site`` is the id of the site it belongs to.

        Its ``shadowing.variance`` is of all that is not known of a place, what remains unknown of the constants
        included: where nothing was ever heard it is the prior's.
        """
        centres = self.centres()
        distance = self.guess.log_distance(centres)
        mean = np.zeros(self.weight.shape)
        variance = np.zeros(self.weight.shape)
        correction = np.zeros((len(self.guess.names), 2))
        for point in range(len(self.guess.names)):
            mean[point], variance[point], correction[point] = self._solve_point(point, centres, distance[:, point])
        names, rows_columns = self.guess.names, (len(self.guess.names), *self.shape)
        path_loss = dataclasses.replace(
            self.guess,
            power_1m=self.guess.power_1m + correction[:, 0],
            exponent=self.guess.exponent + correction[:, 1],
        )
        shadowing = ShadowingMap(
            names, self.origin, self.cell, mean.reshape(rows_columns), variance.reshape(rows_columns)
        )
        return RadioModel(site, path_loss, shadowing)

    def _solve_point(self, point: int, centres: Array, distance: Array) -> tuple[Array, Array, Array]:
        """Return mean (c,) beyond the corrected path loss, variance (c,), and the correction (2,) of P₀ and n."""
        prior = self.prior
        before = prior.shadowing**2 + prior.power**2 + prior.exponent**2 * distance**2
        known = np.flatnonzero(self.weight[point] > LEAST_WEIGHT)
        if not len(known):
            return np.zeros(len(centres)), before, np.zeros(2)
        weight = self.weight[point, known]
        places = self.place[point, known] / weight[:, None]
        residual = self.level[point, known] / weight
        here = self.guess.log_distance(places)[:, point]
        covariance = prior.correlation(places, places) + prior.constants(here, here) + np.diag(1.0 / weight)
        factor = cho_factor(covariance, lower=True)
        solved = cho_solve(factor, residual)
        correction = np.array([prior.power**2 * solved.sum(), -(prior.exponent**2) * float(here @ solved)])
        cross = prior.correlation(centres, places) + prior.constants(distance, here)
        total = cross @ solved
        after = before - np.einsum("ij,ji->i", cross, cho_solve(factor, cross.T))
        return total - (correction[0] - correction[1] * distance), np.maximum(after, 0.0), correction


def novelty(places: Array) -> Array:
    """Return how much of a reading each of a phone's (n, 2) successive ones is, (n,): little where it hardly moved."""
    moved = np.hypot(*np.diff(places, axis=0).T)
    fresh: Array = np.concatenate([np.ones(min(1, len(places))), np.clip(moved / FADED, STILL, 1.0)])
    return fresh


def device_offsets(
    guess: PathLoss,
    prior: RadioPrior,
    device: Index,
    places: Array,
    point: Index,
    residual: Array,
    variance: Array,
    cell: float = 1.0,
) -> Array:
    """Return what each of d phones reads too much, (d,) in dB: generalised least squares, constants and shadowing
    marginalised, so that phones that were at the same places are compared with each other.

    Args:
        guess: from which residuals are taken.
        prior: of constants, shadowing and offsets.
        device: (n,), 0 … d − 1.
        places: (n, 2) metres.
        point: (n,) which access point.
        residual: (n,) heard − guess, dB.
        variance: (n,) of each reading, dB².
        cell: metres; readings of one phone in one cell are averaged beforehand, in larger cells where there would be
            more than ``MOST_PAIRS`` averages.
    """
    count = int(device.max(initial=-1)) + 1
    information, evidence = np.diag(np.full(count, prior.device**-2)), np.zeros(count)
    for which in np.unique(point).tolist():
        mine = np.flatnonzero(point == which)
        group = _gathered(device[mine], places[mine], cell)
        weight = np.bincount(group, 1.0 / variance[mine])
        sums = [np.bincount(group, places[mine, axis] / variance[mine]) for axis in (0, 1)]
        at: Array = np.asarray(np.column_stack(sums) / weight[:, None], np.float64)
        level = np.bincount(group, residual[mine] / variance[mine]) / weight
        owner = np.zeros(len(weight), np.int64)
        owner[group] = device[mine]
        here = guess.log_distance(at)[:, which]
        covariance = prior.correlation(at, at) + prior.constants(here, here) + np.diag(1.0 / weight)
        belongs = (owner[:, None] == np.arange(count)).astype(np.float64)
        solved = cho_solve(cho_factor(covariance, lower=True), np.column_stack([belongs, level]))
        information += belongs.T @ solved[:, :-1]
        evidence += belongs.T @ solved[:, -1]
    offsets: Array = np.asarray(np.linalg.solve(information, evidence), np.float64)
    return offsets


def _gathered(device: Index, places: Array, cell: float) -> Index:
    """Return (n,) which average each reading belongs to: one per phone and cell, of a grid coarse enough."""
    beyond = places - np.floor(places.min(axis=0) / cell) * cell  # one cell in the end, wherever the floor's zero is
    while True:
        key = np.column_stack([device, np.floor(beyond / cell)])
        pairs, group = np.unique(key, axis=0, return_inverse=True)
        if len(pairs) <= MOST_PAIRS or not np.ptp(pairs[:, 1:], axis=0).any():
            return group.ravel().astype(np.int64)
        cell *= 1.5
