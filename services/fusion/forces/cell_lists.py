"""What is near each cell of a grid, as one flat list: found for thousands of places in a few array operations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

__all__ = ["CellLists"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class CellLists:
    """Short lists of numbers, one per cell: ``items[start[cell]:start[cell + 1]]``."""

    start: Indices
    items: Indices

    @classmethod
    def of(cls, shapes: Sequence[BaseGeometry], centres: Array, reach: float) -> CellLists:
        """List which shapes lie within ``reach`` metres of (c, 2) centres of cells."""
        if not shapes:
            return cls(np.zeros(len(centres) + 1, np.int64), np.zeros(0, np.int64))
        cell, item = shapely.STRtree(shapes).query(shapely.points(centres), predicate="dwithin", distance=reach)
        order = np.lexsort((item, cell))
        start = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=len(centres)))])
        return cls(start.astype(np.int64), item[order].astype(np.int64))

    def of_cells(self, cells: Indices) -> tuple[Indices, Indices]:
        """Return row of ``cells`` and item of every pair; a cell of -1 has none."""
        begin = np.where(cells >= 0, self.start[cells], 0)
        count = np.where(cells >= 0, self.start[cells + 1] - begin, 0)
        row = np.repeat(np.arange(len(cells)), count)
        nth = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
        return row, self.items[np.repeat(begin, count) + nth]
