"""How strong is the magnetic field here? Field strengths along good tracks, gathered in cells [ravel-thesis §8.5].

Iron in a building bends the field by place and for good, so a map of it is a fingerprint of the floor. The iron of the
phone and of what lies beside it adds to every reading of a walk alike: each stretch is levelled against what is known
of its cells already before it is added, so that no phone's own error is drawn as if it were a place.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["MagneticMap"]

Array = NDArray[np.float64]

PHONE_SIGMA = 10.0
"""µT, of what a phone's own iron adds to the strength of the field."""
SIGMA = 4.0
"""µT, of a reading about its cell's mean: a cell is not one place, and how a phone is held differs."""
STRENGTHS = (10.0, 150.0)
"""µT; what lies outside is a magnet in a bag or a broken compass, and no place."""
LEAST = 1.5
"""Readings of a cell, faded, below which nothing is told of it."""


class MagneticMap:
    """Mean strength of the field in the cells of a floor; older readings fade.

    Args:
        lower: (2,) corner of the map, metres.
        shape: rows and columns.
        cell: side of a cell, metres.
        half_life: seconds in which an old reading comes to count half.
    """

    def __init__(self, lower: Array, shape: tuple[int, int], cell: float, half_life: float) -> None:
        self._lower, self._cell, self._half_life = np.asarray(lower, float), cell, half_life
        self._weight = np.zeros(shape)
        self._sum = np.zeros(shape)
        self._faded: float | None = None

    def learn(self, t: float, places: Array, strength: Array) -> None:
        """Take in one stretch.

        Args:
            t: seconds, the end of it.
            places: (n, 2) metres; those off the map are left out.
            strength: (n,) µT, NaN where the phone did not tell.
        """
        if self._faded is not None and t > self._faded:
            kept = 0.5 ** ((t - self._faded) / self._half_life)
            self._weight *= kept
            self._sum *= kept
        self._faded = t if self._faded is None else max(self._faded, t)
        spot = np.floor((places - self._lower) / self._cell)
        fine = (np.isfinite(spot) & (spot >= 0.0) & (spot < np.array(self._weight.shape[::-1]))).all(axis=1)
        fine &= (strength > STRENGTHS[0]) & (strength < STRENGTHS[1])
        if not fine.any():
            return
        column, row = spot[fine].astype(np.int64).T
        level = strength[fine] - self._offset(row, column, strength[fine])
        np.add.at(self._weight, (row, column), 1.0)
        np.add.at(self._sum, (row, column), level)

    def strength(self) -> Array:
        """Return (rows, columns) the mean strength, µT; NaN where nothing is known."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(self._weight >= LEAST, self._sum / self._weight, np.nan)

    def state(self) -> dict[str, Any]:
        """Return all the map knows, as plain values."""
        return {"faded": self._faded, "weight": self._weight.tolist(), "sum": self._sum.tolist()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            KeyError, TypeError, ValueError: it is no such state, or of another floor; nothing has changed then.
        """
        weight, total = np.array(state["weight"], float), np.array(state["sum"], float)
        if weight.shape != self._weight.shape or total.shape != weight.shape:
            raise ValueError(f"magnetic map: {weight.shape} cells, this floor has {self._weight.shape}")
        if not (np.isfinite(weight).all() and np.isfinite(total).all() and (weight >= 0.0).all()):
            raise ValueError("magnetic map: weights and sums must be numbers, weights at least 0")
        faded = None if state["faded"] is None else float(state["faded"])
        self._weight, self._sum, self._faded = weight, total, faded

    def _offset(self, row: NDArray[np.int64], column: NDArray[np.int64], strength: Array) -> float:
        """Return by how much this walk's readings are above the map, µT: its mean, drawn to 0 where little is known."""
        weight = self._weight[row, column]
        known = weight >= LEAST
        if not known.any():
            return 0.0
        above = strength[known] - self._sum[row, column][known] / weight[known]
        precision = 1.0 / (SIGMA**2 * (1.0 + 1.0 / weight[known]))
        return float(precision @ above / (precision.sum() + 1.0 / PHONE_SIGMA**2))
