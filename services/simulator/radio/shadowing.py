"""How does the building itself bend received power from place to place? A random field that all phones share.

Correlation exp(-distance / length) after Gudmundson (1991), drawn with random Fourier features (Rahimi, Recht, 2007):
what walls and distance do not explain, and what averaging over time does not take away.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["Lattice", "ShadowingField", "TabulatedFields"]

Array = NDArray[np.float64]

_NODES = 120_000  # most nodes of a lattice: larger floors get a coarser one


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

    def over(self, lattice: Lattice) -> Array:
        """Return the field in dB, (len(lattice.x), len(lattice.y)), on the nodes of a lattice.

        The same numbers as ``at``, but each wave is a product of a part in x and a part in y that turns by the same
        angle from node to node, so that a whole floor costs a matrix product.
        """
        along = _turning(self._waves[0], lattice.x) * np.exp(1j * self._phases)
        across = _turning(self._waves[1], lattice.y)
        left = np.concatenate([along.real, -along.imag], axis=1).astype(np.float32)
        right = np.concatenate([across.real, across.imag], axis=1).astype(np.float32)
        field: Array = self._amplitude * (left @ right.T)
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


class TabulatedFields:
    """Shadowing fields computed once on a lattice and interpolated in between: for millions of points.

    Args:
        fields: c fields.
        lattice: where they are tabulated.
    """

    def __init__(self, fields: Sequence[ShadowingField], lattice: Lattice) -> None:
        self._lattice = lattice
        self._table = np.empty((len(lattice.x) * len(lattice.y), len(fields)), np.float32)
        for column, field in enumerate(fields):
            self._table[:, column] = field.over(lattice).ravel()

    def at(self, points: Array) -> Array:
        """Return the fields in dB, (n, c), at plan points (n, 2); those of the nearest edge outside the lattice."""
        cell, part = self._lattice.cells(points)
        rows = len(self._lattice.y)
        corner = cell[:, 0] * rows + cell[:, 1]
        u, v = part[:, :1], part[:, 1:]
        table = self._table
        low = table[corner] * (1.0 - u) + table[corner + rows] * u
        high = table[corner + 1] * (1.0 - u) + table[corner + rows + 1] * u
        value: Array = low * (1.0 - v) + high * v
        return value


def _turning(waves: Array, nodes: Array) -> NDArray[np.complex128]:
    """Return exp(i · wave · node), (n, features), at evenly spaced nodes (n,)."""
    turns = np.empty((len(nodes), len(waves)), np.complex128)
    turns[0] = np.exp(1j * waves * nodes[0])
    turns[1:] = np.exp(1j * waves * (nodes[1] - nodes[0]))
    return np.cumprod(turns, axis=0, out=turns)
