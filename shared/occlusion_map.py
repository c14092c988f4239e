"""Where nobody ever walks although many pass close by: obstacles learned from where people were seen.

[ravel-thesis §8.5]: a histogram of detections over the floor, cells below a threshold are obstacles. Never visited is
not yet blocked: a cell is judged only where the cells around it have had traffic enough.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes, uniform_filter

__all__ = ["OcclusionMap", "OcclusionSettings"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OcclusionSettings:
    """How the map is kept and read."""

    cell: float = 0.5
    """Metres, side of a cell."""
    half_life: float = 600.0
    """Seconds in which an old visit comes to count half."""
    apart: float = 2.0
    """Seconds a cell must be left alone before the next detection in it is another visit: who stands visits once."""
    around: int = 5
    """Cells, side of the square whose traffic a cell is compared with."""
    least_traffic: float = 15.0
    """Mean visits per cell of that square below which nothing is said of its middle."""
    threshold: float = 0.05
    """Share of that mean below which a cell is blocked."""


class OcclusionMap:
    """Visits to the cells of a floor, older ones fading."""

    def __init__(self, lower: Array, upper: Array, settings: OcclusionSettings | None = None) -> None:
        """Cover the rectangle between (2,) ``lower`` and (2,) ``upper``, metres."""
        self.settings = settings or OcclusionSettings()
        self._lower = np.asarray(lower, dtype=np.float64)
        columns, rows = (math.ceil(side / self.settings.cell) for side in np.asarray(upper) - self._lower)
        self._visits = np.zeros((max(rows, 1), max(columns, 1)))
        self._last = np.full(self._visits.shape, -math.inf)
        self._faded = -math.inf

    def add(self, t: float, places: Array) -> None:
        """Count the detections of one frame; those off the map are left out.

        Args:
            t: seconds; not before the frame added last.
            places: (n, 2) metres.
        """
        self._fade(t)
        spot = np.floor((places - self._lower) / self.settings.cell)
        known = (np.isfinite(spot) & (spot >= 0.0) & (spot < np.array(self._visits.shape[::-1]))).all(axis=1)
        column, row = spot[known].astype(np.int64).T
        fresh = np.zeros(self._visits.shape, np.bool_)
        fresh[row, column] = True
        self._visits[fresh & (t - self._last >= self.settings.apart)] += 1.0
        self._last[fresh] = t

    @property
    def visits(self) -> Array:
        """(rows, columns) visits to each cell, faded."""
        return self._visits

    def blocked_cells(self, visible: NDArray[np.bool_] | None = None) -> NDArray[np.bool_]:
        """Return (rows, columns) which cells are blocked.

        Args:
            visible: (rows, columns) where cameras look; elsewhere nothing is blocked. None: everywhere.
        """
        s = self.settings
        traffic = uniform_filter(self._visits, s.around, mode="nearest")
        empty = self._visits < s.threshold * traffic
        ring = empty & (traffic >= s.least_traffic)
        # Deep inside a large obstacle there is no traffic to compare with: what blocked cells enclose is blocked.
        blocked: NDArray[np.bool_] = binary_fill_holes(ring) & (self._visits < s.threshold * max(s.least_traffic, 1.0))
        blocked |= ring
        return blocked if visible is None else blocked & visible

    def centres(self) -> Array:
        """Return (rows, columns, 2) the centres of the cells, metres."""
        rows, columns = self._visits.shape
        x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
        return self._lower + self.settings.cell * np.stack([x, y], axis=-1)

    def blocked(self, visible: NDArray[np.bool_] | None = None) -> shapely.MultiPolygon:
        """Return the blocked cells as one shape, see ``shape_of``."""
        return self.shape_of(self.blocked_cells(visible))

    def shape_of(self, cells: NDArray[np.bool_]) -> shapely.MultiPolygon:
        """Return (rows, columns) cells as one shape, for ``Obstacles.of_plan``: forces do not depend on their size."""
        low = self.centres()[cells] - 0.5 * self.settings.cell
        high = low + self.settings.cell
        united = shapely.union_all(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))
        return shapely.MultiPolygon([part for part in shapely.get_parts(united) if not part.is_empty])

    def state(self) -> dict[str, Any]:
        """Return all the map knows, as plain values."""
        return {
            "lower": self._lower.tolist(),
            "visits": self._visits.tolist(),
            "last": [[None if t == -math.inf else t for t in row] for row in self._last.tolist()],
            "faded": None if self._faded == -math.inf else self._faded,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Take over what a map of the same floor and cell size knew.

        Raises:
            ValueError: the state is of another floor or another cell size.
        """
        visits = np.array(state["visits"], dtype=np.float64)
        if visits.shape != self._visits.shape or state["lower"] != self._lower.tolist():
            raise ValueError(
                f"the state is of a map of {visits.shape} cells from {state['lower']}, "
                f"this one has {self._visits.shape} from {self._lower.tolist()}"
            )
        self._visits = visits
        self._last = np.array([[-math.inf if t is None else t for t in row] for row in state["last"]])
        self._faded = -math.inf if state["faded"] is None else state["faded"]

    def _fade(self, t: float) -> None:
        if math.isfinite(self._faded) and t > self._faded:
            self._visits *= 0.5 ** ((t - self._faded) / self.settings.half_life)
        self._faded = max(self._faded, t)
