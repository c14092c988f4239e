"""How does the building itself bend received power from place to place? A random field that all phones share.

Correlation exp(-distance / length) after Gudmundson (1991), drawn with random Fourier features (Rahimi, Recht, 2007):
what walls and distance do not explain, and what averaging over time does not take away.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["Lattice", "ShadowingField", "TabulatedField"]

Array = NDArray[np.float64]

_NODES = 250_000  # most nodes of a lattice: larger floors get a coarser one


class ShadowingField:
    """A zero-mean Gaussian random field over the plan with correlation exp(-distance / length).

    Args:
        rng: draws the field; the field itself is then a pure function of the place.
        sigma: standard deviation, dB.
        length: correlation length, metres.
        features: number of random Fourier features.
    """

    def __init__(self, rng: np.random.Generator, sigma: float, length: float, features: int = 384) -> None:
        # The spectrum of the exponential correlation in the plane is a bivariate Student t with one degree of freedom.
        direction = rng.normal(size=(features, 2))
        spread = np.maximum(np.abs(rng.normal(size=(features, 1))), 1e-3)
        self._waves = (direction / spread / length).T
        self._phases = rng.uniform(0.0, 2.0 * np.pi, features)
        self._amplitude = sigma * np.sqrt(2.0 / features)

    def at(self, points: Array) -> Array:
        """Return the field in dB, (n,), at plan points (n, 2)."""
        field: Array = self._amplitude * np.cos(points @ self._waves + self._phases).sum(axis=1)
        return field

    def over(self, x: Array, y: Array) -> Array:
        """Return the field in dB, (len(x), len(y)), on the lattice of plan coordinates ``x`` and ``y``.

        The same numbers as ``at``, but each wave is a product of a part in x and a part in y, so that a whole floor
        costs two matrix products.
        """
        along = np.outer(x, self._waves[0]) + self._phases
        across = np.outer(self._waves[1], y)
        field: Array = self._amplitude * (np.cos(along) @ np.cos(across) - np.sin(along) @ np.sin(across))
        return field


class Lattice:
    """Square cells over a part of the plan, and where points lie in them.

    Args:
        low: least x and y, metres.
        high: greatest x and y.
        spacing: metres between nodes; more where the area would need too many.
    """

    def __init__(self, low: Array, high: Array, spacing: float) -> None:
        width, depth = np.maximum(high - low, spacing)
        self.spacing = max(spacing, math.sqrt(width * depth / _NODES))
        self.x: Array = low[0] + self.spacing * np.arange(math.ceil(width / self.spacing) + 2)
        self.y: Array = low[1] + self.spacing * np.arange(math.ceil(depth / self.spacing) + 2)
        self._low = low

    def cells(self, points: Array) -> tuple[NDArray[np.int64], Array]:
        """Return the cells (n, 2) in which plan points (n, 2) lie, and how far across, (n, 2) in [0, 1].

        What lies outside belongs to the nearest edge.
        """
        last = np.array([len(self.x) - 2, len(self.y) - 2])
        place = np.clip((points - self._low) / self.spacing, 0.0, last + 1.0)
        cell = np.minimum(place.astype(np.int64), last)
        return cell, place - cell


class TabulatedField:
    """A shadowing field computed once on a lattice and interpolated in between: for millions of points.

    Args:
        field: what is tabulated.
        lattice: where.
    """

    def __init__(self, field: ShadowingField, lattice: Lattice) -> None:
        self._lattice = lattice
        self._table = field.over(lattice.x, lattice.y).astype(np.float32)

    def at(self, points: Array) -> Array:
        """Return the field in dB, (n,), at plan points (n, 2); that of the nearest edge outside the lattice."""
        cell, part = self._lattice.cells(points)
        i, j = cell.T
        u, v = part.T
        table = self._table
        value: Array = (table[i, j] * (1 - u) + table[i + 1, j] * u) * (1 - v) + (
            table[i, j + 1] * (1 - u) + table[i + 1, j + 1] * u
        ) * v
        return value
