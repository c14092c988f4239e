"""All maps of one area: kept up frame by frame, read as grids, saved with the rest of what was learned.

Visits and obstacles are sums over everybody, the magnetic map is one over all good walks: nothing here belongs to one
person or phone, so nothing of it is kept by device.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from services.learning.maps.grids import grid_of, radio_grid, shadowing_grid
from services.learning.maps.magnetic_map import MagneticMap
from shared.learning_command import MapKind
from shared.learning_report import MapGrid
from shared.occlusion_map import OcclusionMap, OcclusionSettings
from shared.radio.path_loss import PathLoss
from shared.radio.radio_model import RadioModel
from shared.radio.shadowing_map import ShadowingMap
from shared.site import Site
from shared.site.footprint import footprint

__all__ = ["AreaMaps"]

Array = NDArray[np.float64]

CELL = 0.5
"""Metres [ravel-thesis §8.5]."""
MOST_CELLS = 20_000
"""Of one map; a large floor gets larger cells."""
HALF_LIFE = 3 * 86400.0
"""Seconds: long enough for quiet aisles to gather traffic, short enough for a new exhibition to appear."""
LONGEST_PAUSE = 1.0
"""Seconds between two frames that count as looked at; what is longer was a hole."""
LONGEST_LEAP = 7 * 86400.0
"""Seconds a clock may run ahead between two frames; a broken one does not wipe everything out."""
LEAST_LOOKED = 60.0
"""Seconds a cell must have been looked at before anything is told of it."""
FEWEST = 5.0
"""Visits, faded, from which a cell is told of: of fewer it could be found out whose they were."""


class AreaMaps:
    """The maps of one area.

    Args:
        area: its id.
        outline: where people can be, metres.
        watched: the parts of the floor its cameras look at, (x, y) rings.
        radio: what the site file says of its access points.
    """

    def __init__(
        self,
        area: str,
        outline: shapely.Polygon,
        watched: Sequence[Sequence[tuple[float, float]]],
        radio: PathLoss,
    ) -> None:
        self.area = area
        x0, y0, x1, y1 = outline.bounds
        self._corners = lower, upper = np.array([x0, y0]), np.array([x1, y1])
        cell = max(CELL, math.sqrt(float(np.prod(upper - lower)) / MOST_CELLS))
        self._settings = OcclusionSettings(cell=cell, half_life=HALF_LIFE)
        self._visits = OcclusionMap(lower, upper, self._settings)
        self._centres = self._visits.centres()
        x, y = self._centres[..., 0], self._centres[..., 1]
        self._indoors: NDArray[np.bool_] = shapely.intersects_xy(outline, x, y)
        seen = shapely.union_all([shapely.make_valid(shapely.Polygon(ring)) for ring in watched if len(ring) > 2])
        self._visible: NDArray[np.bool_] = shapely.intersects_xy(seen, x, y) & self._indoors
        self._looked = np.zeros(self._indoors.shape)
        self._magnetic = MagneticMap(lower, self._indoors.shape, cell, HALF_LIFE)
        self._radio = RadioModel("", radio, _flat(radio, lower, cell))
        self._t: float | None = None
        self._clock = 0.0

    @classmethod
    def of_site(cls, site: Site, area: str) -> AreaMaps:
        """Return empty maps of an area of a site; KeyError: it has no such area."""
        floor = site.floor(site.area(area).floor)
        outline = floor.plan().outline
        watched = [footprint(cam.geometry.build(), cam.area_of_interest, outline) for cam in site.cameras_of(area)]
        points = [point for point in site.access_points if point.floor == floor.id]
        return cls(area, outline, watched, PathLoss.of(points))

    def look(self, t: float, places: Array) -> None:
        """Take in what the area's cameras saw at ``t``, also when nobody was there.

        Args:
            t: seconds since the epoch. A clock that was set back fades nothing and goes on from there.
            places: (n, 2) metres: the people confirmed by cameras, or their detections.
        """
        passed = 0.0 if self._t is None else min(max(t - self._t, 0.0), LONGEST_LEAP)
        self._t = t
        self._clock += passed
        self._looked *= 0.5 ** (passed / HALF_LIFE)
        self._looked[self._visible] += min(passed, LONGEST_PAUSE)
        self._visits.add(self._clock, np.asarray(places, float).reshape(-1, 2))

    def learn(self, places: Array, field: Array) -> None:
        """Take in a good stretch: (n, 2) metres where the phone measured the field (n,), µT, NaN where it did not."""
        self._magnetic.learn(self._clock, places, field)

    def grid(self, kind: MapKind, model: RadioModel | None = None, access_point: str | None = None) -> MapGrid | None:
        """Return a map, or None where nothing is learned yet, of radio where nobody knows where the access point hangs.

        Args:
            kind: which.
            model: the area's active radio model; None: as the site file says.
            access_point: for ``radio`` and ``shadowing``.

        Raises:
            ValueError: ``radio`` or ``shadowing`` of no access point, or of one the area does not have.
        """
        cell, origin = self._settings.cell, self._centres[0, 0]
        if kind in ("radio", "shadowing"):
            names = (model or self._radio).path_loss.names
            if access_point not in names:
                raise ValueError(f"access_point: found {access_point!r}, allowed: {', '.join(names) or 'none'}")
            if not self.placed(access_point, model):
                return None
            if kind == "radio":
                return radio_grid(self.area, model or self._radio, access_point, self._centres, self._indoors)
            return None if model is None else _known(shadowing_grid(self.area, model, access_point))
        if kind == "magnetic":
            return _known(grid_of(self.area, kind, "µT", origin, cell, self._magnetic.strength()))
        if kind == "visits":
            return _known(grid_of(self.area, kind, "visits per hour", origin, cell, self._visits_per_hour()))
        return _known(grid_of(self.area, kind, "blocked", origin, cell, self._occlusion()))

    def placed(self, access_point: str, model: RadioModel | None) -> bool:
        """Whether a model, or the site file, says where an access point of the area hangs."""
        loss = (model or self._radio).path_loss
        return bool(loss.placed[loss.names.index(access_point)])

    def blocked(self) -> NDArray[np.bool_]:
        """Return (rows, columns) the cells nobody walks on although many pass close by."""
        return self._visits.blocked_cells(self._looked >= LEAST_LOOKED)

    def state(self) -> dict[str, Any]:
        """Return all that was learned, as plain values."""
        return {
            "t": self._t,
            "clock": self._clock,
            "looked": self._looked.tolist(),
            "visits": self._visits.state(),
            "magnetic": self._magnetic.state(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            ValueError: it is no such state, or of another floor; nothing has changed then.
        """
        rows = self._indoors.shape
        visits = OcclusionMap(*self._corners, self._settings)
        magnetic = MagneticMap(self._corners[0], (rows[0], rows[1]), self._settings.cell, HALF_LIFE)
        try:
            looked, clock = np.array(state["looked"], float), float(state["clock"])
            t = None if state["t"] is None else float(state["t"])
            visits.restore(state["visits"])
            magnetic.restore(state["magnetic"])
        except (KeyError, TypeError) as error:
            raise ValueError(f"maps of area {self.area}: no saved state: {error!r}") from error
        numbers = [looked, visits.visits, np.array([clock, t or 0.0])]
        if looked.shape != rows or not all(np.isfinite(part).all() for part in numbers):
            raise ValueError(
                f"maps of area {self.area}: the saved state is of another floor or holds what is no number"
            )
        self._looked, self._clock, self._t = looked, clock, t
        self._visits, self._magnetic = visits, magnetic

    def _visits_per_hour(self) -> Array:
        visits = self._visits.visits
        known = (self._looked >= LEAST_LOOKED) & ((visits == 0.0) | (visits >= FEWEST))
        return np.where(known, 3600.0 * visits / np.where(known, self._looked, 1.0), np.nan)

    def _occlusion(self) -> Array:
        walked = np.where(self._visits.visits >= FEWEST, 0.0, np.nan)
        return np.where(self.blocked(), 1.0, walked)


def _flat(radio: PathLoss, lower: Array, cell: float) -> ShadowingMap:
    nothing = np.zeros((len(radio.names), 1, 1))
    return ShadowingMap(radio.names, lower, cell, nothing, nothing)


def _known(grid: MapGrid) -> MapGrid | None:
    return grid if any(value is not None for row in grid.rows for value in row) else None
