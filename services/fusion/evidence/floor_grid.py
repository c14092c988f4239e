"""Where could somebody be whom no camera sees? The floor in cells, and densities over it that walk and spread."""

from __future__ import annotations

import math

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from services.fusion.area_view import AreaView

__all__ = ["FloorGrid"]

Array = NDArray[np.float64]

CELL = 0.5
"""Metres; the side of a cell, unless the floor is large."""
MOST_CELLS = 3000
WELL_INSIDE = 0.3
"""Metres from the border of a view from which on its camera should see a person."""
SEEN_EDGE = 1.0
"""Metres; where cameras see nearer than this to the floor's edge, people may come and go over it."""


class FloorGrid:
    """The cells of one floor, and of a margin around it.

    Attributes:
        cell: side of a cell, metres.
        shape: (rows, columns).
        centres: (n, 2) metres, row by row.
        open: (rows, columns), where people can be: not inside obstacles.
        outside: (rows, columns), beyond the floor's outline where its edge is out of view: behind walls, most likely.
        viewed: (rows, columns), where a camera of the area looks.
        indoors: (n,), open and not outside; each cell's share of all such cells.
        area: of these, m².
    """

    def __init__(self, view: AreaView) -> None:
        width, depth = (view.upper - view.lower).tolist()
        self.lower = view.lower
        self.cell = max(CELL, math.sqrt(width * depth / MOST_CELLS))
        self.shape = (max(1, math.ceil(depth / self.cell)), max(1, math.ceil(width / self.cell)))
        columns, rows = np.meshgrid(np.arange(self.shape[1]), np.arange(self.shape[0]))
        self.centres: Array = self.lower + (np.column_stack([columns.ravel(), rows.ravel()]) + 0.5) * self.cell
        inside = view.plan.contains(self.centres)
        self.open: NDArray[np.bool_] = (view.plan.walkable(self.centres) | ~inside).reshape(self.shape)
        depth = view.everywhere.depth_at(self.centres)
        beyond = shapely.distance(view.plan.outline, shapely.points(self.centres))
        self.outside: NDArray[np.bool_] = (~inside & (-depth - beyond > SEEN_EDGE)).reshape(self.shape)
        self.viewed: NDArray[np.bool_] = (depth.reshape(self.shape) > WELL_INSIDE) & self.open
        indoors = (self.open & ~self.outside).ravel()
        self.indoors: Array = indoors / max(float(indoors.sum()), 1.0)
        self.area = float(indoors.sum()) * self.cell**2

    def cells_at(self, places: Array) -> NDArray[np.int64]:
        """Return the number (n,) of the cell that each of (n, 2) places lies in, the nearest for one off the grid."""
        spot = ((places - self.lower) / self.cell).astype(np.int64)
        column = np.minimum(np.maximum(spot[:, 0], 0), self.shape[1] - 1)
        row = np.minimum(np.maximum(spot[:, 1], 0), self.shape[0] - 1)
        cells: NDArray[np.int64] = row * self.shape[1] + column
        return cells

    def kernel(self, place: Array, sigma: float) -> Array:
        """Return a normal density (n,), per m², about a (2,) place."""
        sigma = max(sigma, 0.6 * self.cell)
        squared = ((self.centres - place) ** 2).sum(axis=1)
        density: Array = np.exp(-0.5 * squared / sigma**2) / (2.0 * math.pi * sigma**2)
        return density

    def shift(self, density: Array, columns: int, rows: int) -> Array:
        """Return a (rows, columns) density moved by whole cells; what leaves the grid is gone."""
        moved = np.zeros_like(density)
        height, width = self.shape
        if abs(rows) < height and abs(columns) < width:
            moved[max(rows, 0) : height + min(rows, 0), max(columns, 0) : width + min(columns, 0)] = density[
                max(-rows, 0) : height + min(-rows, 0), max(-columns, 0) : width + min(-columns, 0)
            ]
        return moved * self.open

    def blur(self, density: Array, sigma: float) -> Array:
        """Return a density spread by ``sigma`` metres; what leaves the grid is gone."""
        spread: Array = gaussian_filter(density, sigma / self.cell, mode="constant", truncate=3.0)
        return spread * self.open
