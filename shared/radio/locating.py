"""Where does an access point hang? From what was heard of it at known places: the posterior over a grid of positions.

At each candidate position power and exponent are marginalised, shadowing counts as noise that neighbours share: so the
spread of the posterior is what readings really tell, and two walks along one line leave two places, one on each side.
The height is taken as known, for people's phones are all at one height and tell little of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from shared.radio.path_loss import DEVICE_HEIGHT, NEAREST
from shared.radio.radio_learning import RadioPrior

__all__ = ["Whereabouts", "locate_access_point"]

Array = NDArray[np.float64]

MOST_MEANS = 500
"""Into which readings are averaged; more get larger cells."""
MOST_CANDIDATES = 4000
POWER, EXPONENT = 8.0, 0.4
"""dB, and of the exponent: how far an access point may send otherwise than the first guess."""


@dataclass(frozen=True)
class Whereabouts:
    """What readings tell of a position.

    Attributes:
        place: (2,) mean of the posterior, metres.
        covariance: (2, 2) m².
        gain: nats by which the best place explains the readings better than the one asked about; 0 where none was.
    """

    place: Array
    covariance: Array
    gain: float

    @property
    def error(self) -> float:
        """Standard deviation, metres, in the worse direction."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance)[-1]))


def locate_access_point(
    places: Array,
    level: Array,
    weight: Array,
    lower: Array,
    upper: Array,
    *,
    height: float,
    power: float,
    exponent: float,
    asked: Array | None = None,
    sure: tuple[float, float] = (POWER, EXPONENT),
    prior: RadioPrior | None = None,
) -> Whereabouts:
    """Return where an access point hangs.

    Args:
        places: (n, 2) metres, n > 0.
        level: (n,) heard there, phones' offsets taken off, dBm.
        weight: (n,) inverse variance of each beyond shadowing, dB⁻².
        lower: (2,) corner of where it may hang, metres; ``upper`` the other.
        upper: see above.
        height: of it above the floor, metres.
        power: first guess of dBm one metre away; ``exponent`` likewise.
        exponent: see above.
        asked: (2,) where it was believed to hang, if anywhere; there it may send quite otherwise than the first guess.
        sure: standard deviations of power (dB) and exponent about the first guess elsewhere: less than the default
            where it was heard before it moved.
        prior: of shadowing.
    """
    prior = prior or RadioPrior()
    places, level, weight = _averaged(places, level, weight)
    step = max(0.5, float(np.sqrt(np.prod(upper - lower) / MOST_CANDIDATES)))
    x, y = (np.arange(low, high + step, step) for low, high in zip(lower, upper, strict=True))
    over = np.column_stack([grid.ravel() for grid in np.meshgrid(x, y)])
    candidates = over if asked is None else np.vstack([over, asked])
    squared = ((places[:, None] - candidates[None]) ** 2).sum(axis=2) + (height - DEVICE_HEIGHT) ** 2
    distance = 5.0 * np.log10(np.maximum(squared, NEAREST**2))
    factor = cholesky(prior.correlation(places, places) + np.diag(1.0 / weight), lower=True)
    whitened = solve_triangular(factor, np.column_stack([np.ones(len(level)), level - power, distance]), lower=True)
    one, beyond, away = whitened[:, 0], whitened[:, 1], whitened[:, 2:]
    residual = beyond[:, None] + exponent * away
    # Woodbury, for the two constants: S⁻¹ + U' C⁻¹ U and U' C⁻¹ y, U = [1, −distance].
    spread = np.tile(np.array(sure)[:, None], len(candidates))
    spread[:, len(over) :] = np.array([[POWER], [EXPONENT]])
    a = spread[0] ** -2 + float(one @ one)
    b, d = -(one @ away), spread[1] ** -2 + (away**2).sum(axis=0)
    first, second = one @ residual, -(away * residual).sum(axis=0)
    determinant = a * d - b**2
    explained = (d * first**2 - 2.0 * b * first * second + a * second**2) / determinant
    volume = np.log(determinant) + 2.0 * np.log(spread).sum(axis=0)
    nats = 0.5 * (explained - (residual**2).sum(axis=0) - volume)
    grid = nats[: len(over)]
    chance = np.exp(grid - grid.max())
    chance /= chance.sum()
    place = chance @ over
    off = over - place
    covariance = (chance[:, None] * off).T @ off + step**2 / 12.0 * np.eye(2)
    return Whereabouts(place, covariance, 0.0 if asked is None else float(grid.max() - nats[-1]))


def _averaged(places: Array, level: Array, weight: Array) -> tuple[Array, Array, Array]:
    """Return means over the cells of a grid, coarse enough."""
    cell = 1.0
    while True:
        keys = np.floor(places / cell).astype(np.int64)
        found, group = np.unique(keys, axis=0, return_inverse=True)
        if len(found) <= MOST_MEANS:
            break
        cell *= 1.5
    group = group.ravel()
    total: Array = np.asarray(np.bincount(group, weight), np.float64)
    sums = [np.bincount(group, weight * column) / total for column in (*places.T, level)]
    return np.column_stack(sums[:2]), sums[2], total
