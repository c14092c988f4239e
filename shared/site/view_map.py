"""What does each camera see of the floor? A map of how far inside its view each place lies."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy  # its parts are loaded when they are used
import shapely
from numpy.typing import NDArray

from shared.site.floor_plan import FloorPlan
from shared.site.site_file import Camera, Site

__all__ = ["CameraViews", "ViewMap", "camera_views"]

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
class CameraViews:
    """What the cameras of one area see.

    Attributes:
        lower: (2,) and ``upper``: (2,), corners of the floor with ``MARGIN`` around it, metres.
        upper: see above.
        each: by camera id.
        everywhere: the union of all views.
    """

    lower: Array
    upper: Array
    each: dict[str, ViewMap]
    everywhere: ViewMap


def camera_views(site: Site, area_id: str, plan: FloorPlan | None = None) -> CameraViews:
    """Return what the cameras of an area see of its floor; ``plan``: that floor's, where it was built before.

    Raises:
        KeyError: the site has no such area.
    """
    plan = plan or site.floor(site.area(area_id).floor).plan()
    x0, y0, x1, y1 = plan.outline.bounds
    lower, upper = np.array([x0, y0]) - MARGIN, np.array([x1, y1]) + MARGIN
    cell = max(CELL, float((upper - lower).max()) / MOST_CELLS)
    shape = tuple(math.ceil(extent / cell) for extent in (upper - lower)[::-1])
    columns, rows = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    centres = lower + (np.column_stack([columns.ravel(), rows.ravel()]) + 0.5) * cell
    masks = {camera.id: _seen(camera, plan, centres).reshape(shape) for camera in site.cameras_of(area_id)}
    union = np.logical_or.reduce(list(masks.values())) if masks else np.zeros(shape, np.bool_)
    return CameraViews(
        lower=lower,
        upper=upper,
        each={name: ViewMap(lower, cell, _depth(mask, cell)) for name, mask in masks.items()},
        everywhere=ViewMap(lower, cell, _depth(union, cell)),
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
    inside = scipy.ndimage.distance_transform_edt(framed)[1:-1, 1:-1]
    outside = scipy.ndimage.distance_transform_edt(~mask)
    depth: Array = np.where(mask, inside - 0.5, 0.5 - outside) * cell
    return depth
