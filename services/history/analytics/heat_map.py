"""Where do people stay? Seconds and people per cell, cells with few people left out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.history.analytics.anonymity import surely

__all__ = ["HeatMapSum", "grid_of"]


def grid_of(bounds: tuple[float, float, float, float], cell: float) -> tuple[tuple[float, float], int, int]:
    """Return origin, rows and columns of the grid of square cells that covers (least x, least y, greatest x, y)."""
    left, bottom, right, top = bounds
    return (left, bottom), max(int(np.ceil((top - bottom) / cell)), 1), max(int(np.ceil((right - left) / cell)), 1)


MOST_LOOSE = 2_000_000
"""Pairs of person and cell that may stand twice before they are joined."""


class HeatMapSum:
    """Adds positions up, part by part; memory grows with people times the cells each was in.

    Args:
        origin: lower left corner of the first cell, m.
        cell: side of a cell, m.
        rows: number of them; ``columns`` likewise.
    """

    def __init__(self, origin: tuple[float, float], cell: float, rows: int, columns: int) -> None:
        self._origin = origin
        self._cell = cell
        self._shape = rows, columns
        self._seconds = np.zeros(rows * columns)
        self._pairs: list[NDArray[np.int64]] = []
        """Who was in which cell: each once within a part."""

    def add(
        self, person: NDArray[np.int64], x: NDArray[np.float64], y: NDArray[np.float64], seconds: NDArray[np.float64]
    ) -> None:
        """Add points, shape (n,): whose, where (m), and how many seconds each stands for. Outside the grid: nothing."""
        rows, columns = self._shape
        column = np.floor((x - self._origin[0]) / self._cell)
        row = np.floor((y - self._origin[1]) / self._cell)
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        cells = (row[inside] * columns + column[inside]).astype(np.int64)
        self._seconds += np.bincount(cells, seconds[inside], minlength=rows * columns)
        pairs = person[inside] * (rows * columns) + cells
        # Who stays in a cell says so every second: most of it goes before anything is sorted.
        self._pairs.append(_distinct(pairs[np.flatnonzero(np.diff(pairs, prepend=-1))]))
        if sum(part.size for part in self._pairs) > 2 * self._pairs[0].size + MOST_LOOSE:
            self._pairs = [_distinct(np.concatenate(self._pairs))]

    def told(self, known: NDArray[np.bool_], fewest: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return seconds and people of each cell, shape (rows, columns); 0 where surely fewer than ``fewest`` were.

        Args:
            known: whether each person is the carrier of a known phone, by number.
            fewest: people.
        """
        cells = self._seconds.size
        pairs = _distinct(np.concatenate([np.empty(0, np.int64), *self._pairs]))
        people = np.bincount(pairs % cells, minlength=cells)
        carriers = np.bincount(pairs[known[pairs // cells]] % cells, minlength=cells)
        enough = surely(people, carriers) >= fewest
        return np.where(enough, self._seconds, 0.0).reshape(self._shape), np.where(enough, people, 0).reshape(
            self._shape
        )


def _distinct(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """``np.unique`` by sorting, several times faster here than by hashing."""
    in_order = np.sort(values)
    return in_order[np.flatnonzero(np.diff(in_order, prepend=-1))]
