"""What fusion knows of its area before it starts: the floor, what each camera sees of it, the access points."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from shared.radio import PathLoss, ShadowingMap
from shared.site import Camera, FloorPlan, Site

__all__ = ["AreaView", "ViewMap"]

Array = NDArray[np.float64]

CELL = 0.25
"""Metres; the side of a cell of the view map, unless the floor is very large."""
MOST_CELLS = 1000
"""Along one side of the map."""
MARGIN = 3.0
"""Metres around the floor's outline within which a detection is still believed."""


@dataclass(frozen=True)
class ViewMap:
    """How far inside a camera's view each place on the floor lies.

    Attributes:
        origin: (2,), the map's lower left corner, metres.
        cell: side of a cell, metres.
        depth: (rows, columns), metres to the border of the view, positive inside, negative outside.
    """

    origin: Array
    cell: float
    depth: Array

    def depth_at(self, places: Array) -> Array:
        """Return (n,) metres to the border of the view, negative outside, of (n, 2) places (clamped to the map)."""
        rows, columns = self.depth.shape
        cells = ((places - self.origin) / self.cell).astype(np.int64)
        cells = np.minimum(np.maximum(cells, 0), (columns - 1, rows - 1))
        found: Array = self.depth[cells[:, 1], cells[:, 0]]
        return found


@dataclass(frozen=True)
class AreaView:
    """One area as its tracker sees it.

    Attributes:
        area: its id.
        floor: the floor it lies on.
        lower: (2,) and ``upper``: (2,), corners of the floor, metres; beyond ``MARGIN`` of it nothing is believed.
        views: by camera id.
        everywhere: the union of all views.
        radio: first guess of the path loss of the floor's access points.
        plan: the floor's outline, walls and obstacles.
        shadowing: what was learned of the radio beyond path loss, its access points in the order of ``radio``; None
            where nothing was.
    """

    area: str
    floor: str
    lower: Array
    upper: Array
    views: dict[str, ViewMap]
    everywhere: ViewMap
    radio: PathLoss
    plan: FloorPlan
    shadowing: ShadowingMap | None = None

    @classmethod
    def of(cls, site: Site, area_id: str) -> AreaView:
        """Return the view of one area of a site.

        Raises:
            KeyError: the site has no such area.
        """
        area = site.area(area_id)
        plan = site.floor(area.floor).plan()
        x0, y0, x1, y1 = plan.outline.bounds
        lower, upper = np.array([x0, y0]) - MARGIN, np.array([x1, y1]) + MARGIN
        cell = max(CELL, float((upper - lower).max()) / MOST_CELLS)
        shape = tuple(math.ceil(extent / cell) for extent in (upper - lower)[::-1])
        columns, rows = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
        centres = lower + (np.column_stack([columns.ravel(), rows.ravel()]) + 0.5) * cell
        masks = {camera.id: _seen(camera, plan, centres).reshape(shape) for camera in site.cameras_of(area_id)}
        union = np.logical_or.reduce(list(masks.values())) if masks else np.zeros(shape, np.bool_)
        return cls(
            area=area_id,
            floor=area.floor,
            lower=lower,
            upper=upper,
            views={name: ViewMap(lower, cell, _depth(mask, cell)) for name, mask in masks.items()},
            everywhere=ViewMap(lower, cell, _depth(union, cell)),
            radio=PathLoss.of([point for point in site.access_points if point.floor == area.floor]),
            plan=plan,
        )


def _seen(camera: Camera, plan: FloorPlan, places: Array) -> NDArray[np.bool_]:
    """Whether feet at each of (n, 2) places appear in the camera's picture, inside its area of interest."""
    geometry = camera.geometry.build()
    width, height = geometry.image_size
    pixels = geometry.to_image(np.column_stack([places, np.zeros(len(places))]))
    ring = camera.area_of_interest or [(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)]
    inside = shapely.intersects_xy(shapely.Polygon(ring), pixels[:, 0], pixels[:, 1])
    # A distorted lens folds far-away places back into the picture: only those that see themselves again count.
    again = geometry.to_ground(np.where(np.isfinite(pixels), pixels, 0.0))
    true = np.linalg.norm(again - places, axis=1) < 0.5
    seen: NDArray[np.bool_] = inside & true & plan.contains(places)
    return seen


def _depth(mask: NDArray[np.bool_], cell: float) -> Array:
    """Return the signed distance in metres to the border of a mask; where all or nothing is seen, a large number."""
    far = float(np.hypot(*mask.shape)) * cell
    if not mask.any():
        return np.full(mask.shape, -far)
    framed = np.pad(mask, 1)
    inside = distance_transform_edt(framed)[1:-1, 1:-1]
    outside = distance_transform_edt(~mask)
    depth: Array = np.where(mask, inside - 0.5, 0.5 - outside) * cell
    return depth
