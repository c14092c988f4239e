"""What bends a compass here? The Earth's field, a building's own, and iron in walls and things, by place.

The disturbance is a random field in plan coordinates with a Gaussian correlation over some two metres, strong beside
walls and obstacles and weak in the open. It is frozen: the same place bends every phone's compass the same way, so that
nobody can average it away by waiting. "Soft iron, rapidly varying indoors" [self-calibrating-rss-thesis §3.1].
"""

from __future__ import annotations

import math

import numpy as np
import shapely
from numpy.typing import NDArray
from pydantic import Field

from services.simulator.seeds import generator
from shared.site import Floor, Site
from shared.site.site_file import Number, Part

__all__ = ["MagneticField", "MagneticParameters"]

Array = NDArray[np.float64]

_FEATURES = 96
_MARGIN = 3.0  # metres around the outline that the table covers: people come in at doors
_CELLS = 250_000  # cells of the table of one floor at most


class MagneticParameters(Part):
    """The magnetic field of a building; µT unless said otherwise."""

    strength: Number = Field(48.0, ge=20, le=70, description="of the Earth's field, µT")
    dip: Number = Field(62.0, ge=-89, le=89, description="by which it points below the horizon, degrees")
    building_sigma: Number = Field(1.5, ge=0, le=20, description="of what the whole building adds, per axis, µT")
    open_sigma: Number = Field(2.5, ge=0, le=50, description="of the disturbance far from any wall, per axis, µT")
    wall_sigma: Number = Field(10.0, ge=0, le=100, description="of the disturbance at a wall or obstacle, per axis, µT")
    wall_reach: Number = Field(1.0, gt=0, le=10, description="distance in which a wall's share falls to 1/e, m")
    length: Number = Field(2.0, ge=0.5, le=20, description="correlation length of the disturbance, m")


class MagneticField:
    """The magnetic field of one site. Same site, seed and parameters: the same field, bit for bit."""

    def __init__(self, site: Site, parameters: MagneticParameters, seed: int) -> None:
        chosen = parameters
        dip, north = math.radians(chosen.dip), site.north_radians
        level = chosen.strength * math.cos(dip)
        building = generator(seed, "magnetic building").normal(0.0, chosen.building_sigma, 3)
        self.earth: Array = np.array(
            [level * math.cos(north), level * math.sin(north), -chosen.strength * math.sin(dip)]
        )
        """(3,) µT in plan axes (x, y, up), without any building."""
        self._mean = self.earth + building
        self._floors = {floor.id: _Table(floor, generator(seed, "magnetic", floor.id), chosen) for floor in site.floors}

    def at(self, points: Array, floor: str) -> Array:
        """Return the field, (n, 3) µT in plan axes (x, y, up), at plan points (n, 2). KeyError: no such floor."""
        return self._mean + self._floors[floor].at(points)


class _Table:
    """The disturbance on one floor, drawn once on a grid and interpolated between."""

    def __init__(self, floor: Floor, rng: np.random.Generator, parameters: MagneticParameters) -> None:
        plan = floor.plan()
        left, bottom, right, top = plan.outline.buffer(_MARGIN).bounds
        self._origin = np.array([left, bottom])
        spacing = parameters.length / 4.0
        self._spacing = max(spacing, math.sqrt((right - left) * (top - bottom) / _CELLS))
        self._columns = math.ceil((right - left) / self._spacing) + 2
        self._rows = math.ceil((top - bottom) / self._spacing) + 2
        x = left + self._spacing * np.arange(self._columns)
        y = bottom + self._spacing * np.arange(self._rows)
        # Random Fourier features (Rahimi and Recht, 2007) of the kernel exp(-d² / (2 length²)), apart in x and y.
        waves = rng.normal(0.0, 1.0 / parameters.length, (3, _FEATURES, 2))
        phases = rng.uniform(0.0, 2.0 * math.pi, (3, _FEATURES))
        along = np.exp(1j * (waves[:, None, :, 0] * x[None, :, None] + phases[:, None, :]))  # (3, columns, features)
        across = np.exp(1j * waves[:, None, :, 1] * y[None, :, None])  # (3, rows, features)
        field = math.sqrt(2.0 / _FEATURES) * np.real(across @ along.transpose(0, 2, 1))  # (3, rows, columns)
        iron = shapely.union_all([plan.outline.exterior, plan.walls, plan.obstacles])
        distance = shapely.distance(iron, shapely.points(*np.meshgrid(x, y)))
        sigma = np.hypot(parameters.open_sigma, parameters.wall_sigma * np.exp(-distance / parameters.wall_reach))
        # Rounded, because the last bits of a product of matrices depend on the processor and its number of threads.
        table = np.round(field * sigma, 6).transpose(1, 2, 0).reshape(-1, 3)
        self._values: Array = np.ascontiguousarray(table)

    def at(self, points: Array) -> Array:
        place = (points - self._origin) / self._spacing
        column = np.clip(place[:, 0], 0.0, self._columns - 1.001)
        row = np.clip(place[:, 1], 0.0, self._rows - 1.001)
        i, j = column.astype(np.int64), row.astype(np.int64)
        u, v = (column - i)[:, None], (row - j)[:, None]
        first, values = j * self._columns + i, self._values
        below = (1.0 - u) * values[first] + u * values[first + 1]
        above = (1.0 - u) * values[first + self._columns] + u * values[first + self._columns + 1]
        field: Array = (1.0 - v) * below + v * above
        return field
