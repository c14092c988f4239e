"""How deep does each of many points lie in each zone nearby, and which zones does a step cut?

A grid of cells per floor lists the zones near each cell and, where a whole cell lies at one depth, that depth; only
points in cells that a border cuts are tested exactly, by prepared shapely polygons. Fast steps go to an R-tree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

__all__ = ["BAND", "CORE", "OUTSIDE", "WITHIN", "ZoneIndex"]

OUTSIDE, BAND, WITHIN, CORE = 0, 1, 2, 3
"""Depths: farther than the margin from the zone; outside by less than that; inside; inside by the margin or more."""

_MIXED = -1
_SMALLEST_CELL = 0.25
_MOST_CELLS = 65536

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Depths = NDArray[np.int8]
Pairs = tuple[Ints, Ints, Depths]


@dataclass(frozen=True)
class _Grid:
    """Cells of one floor in rows from ``origin``; cell c lists zone[start[c]:start[c + 1]] with their depths."""

    origin: tuple[float, float]
    cell: float
    shape: tuple[int, int]
    start: Ints
    zone: Ints
    depth: Depths


class ZoneIndex:
    """The zones of one site.

    Args:
        rings: corners (x, y) of each zone, metres.
        floors: the floor of each zone.
        margin: width of the undecided band on either side of a border, metres.
    """

    def __init__(self, rings: Sequence[Sequence[tuple[float, float]]], floors: Sequence[str], margin: float) -> None:
        self.margin = margin
        zones = np.array([shapely.Polygon(ring) for ring in rings], dtype=object)
        self._zones = zones
        self._outer = _buffered(zones, margin)
        self._core = _buffered(zones, -margin)
        for shapes in (self._zones, self._outer, self._core):
            shapely.prepare(shapes)
        self._floor_numbers = {name: number for number, name in enumerate(dict.fromkeys(floors))}
        self.floor = np.array([self._floor_numbers[name] for name in floors], dtype=np.int64)
        """Number of each zone's floor."""
        self._tree = shapely.STRtree(zones)
        self._grids = [self._grid(np.flatnonzero(self.floor == number)) for number in range(len(self._floor_numbers))]

        borders = [shapely.union_all(shapely.boundary(zones[self.floor == n])) for n in range(len(self._floor_numbers))]
        self._borders = np.array(borders, dtype=object)

    def clear_of_borders(self, x: Floats, y: Floats, floor: Ints, radius: Floats) -> NDArray[np.bool_]:
        """Whether each of (n,) discs of so many metres crosses no border of a zone of its floor, margin included."""
        clear = np.ones(len(x), np.bool_)
        here = np.flatnonzero(floor >= 0)
        distance = shapely.distance(self._borders[floor[here]], shapely.points(x[here], y[here]))
        clear[here] = distance > radius[here] + self.margin
        return clear

    def __len__(self) -> int:
        return len(self._zones)

    def floors_of(self, names: Sequence[str]) -> Ints:
        """Return the numbers of these floors, (n,); -1 for a floor without zones."""
        numbers = self._floor_numbers
        return np.fromiter((numbers.get(name, -1) for name in names), np.int64, len(names))

    def nearby(self, x: Floats, y: Floats, floor: Ints) -> Pairs:
        """Return the pairs of a point and a zone that is not surely ``OUTSIDE``.

        Args:
            x: (n,) metres.
            y: (n,) metres.
            floor: (n,) floor numbers.

        Returns:
            row: (m,) which point.
            zone: (m,) which zone; each pair comes once.
            depth: (m,) one of OUTSIDE, BAND, WITHIN, CORE.
        """
        found = []
        for number, grid in enumerate(self._grids):
            rows = np.flatnonzero(floor == number)
            if len(rows) == 0:
                continue
            column = np.floor((x[rows] - grid.origin[0]) / grid.cell)
            line = np.floor((y[rows] - grid.origin[1]) / grid.cell)
            on_grid = (column >= 0) & (line >= 0) & (column < grid.shape[1]) & (line < grid.shape[0])
            rows = rows[on_grid]
            cell = line[on_grid].astype(np.int64) * grid.shape[1] + column[on_grid].astype(np.int64)
            first = grid.start[cell]
            count = grid.start[cell + 1] - first
            row = np.repeat(rows, count)
            # Ranges first[i] .. first[i] + count[i], one after the other.
            entry = np.arange(len(row)) + np.repeat(first - np.cumsum(count) + count, count)
            zone, depth = grid.zone[entry], grid.depth[entry].copy()
            mixed = np.flatnonzero(depth == _MIXED)
            depth[mixed] = self.depth(zone[mixed], x[row[mixed]], y[row[mixed]])
            found.append((row, zone, depth))
        if len(found) == 1:
            return found[0]
        if not found:
            return np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0, np.int8)
        rows_, zones_, depths_ = zip(*found, strict=True)
        return np.concatenate(rows_), np.concatenate(zones_), np.concatenate(depths_)

    def depth(self, zone: Ints, x: Floats, y: Floats) -> Depths:
        """Return the exact depth (m,) of each point in the zone beside it."""
        depth = np.zeros(len(zone), np.int8)
        left = np.arange(len(zone))
        for shapes in (self._outer, self._zones, self._core):
            left = left[shapely.intersects_xy(shapes[zone[left]], x[left], y[left])]
            depth[left] += 1
        return depth

    def cut(self, segments: Floats, floor: Ints) -> tuple[Ints, Ints]:
        """Return the pairs of one of (k, 2, 2) segments and a zone of its floor that touch: (pairs,) each."""
        row, zone = self._tree.query(_lines(segments), predicate="intersects")
        same = self.floor[zone] == floor[row]
        return row[same].astype(np.int64), zone[same].astype(np.int64)

    def touches(self, zone: Ints, segments: Floats) -> NDArray[np.bool_]:
        """Whether each of (m, 2, 2) segments touches the zone beside it."""
        touched: NDArray[np.bool_] = shapely.intersects(self._zones[zone], _lines(segments))
        return touched

    def chord(self, zone: int, segment: Floats) -> tuple[float, float] | None:
        """Return where the (2, 2) segment enters and leaves the zone, as shares of its length; None: it does not."""
        line = shapely.LineString(segment)
        inside = shapely.intersection(self._zones[zone], line)
        if inside.is_empty:
            return None
        length = float(line.length)
        shares = shapely.line_locate_point(line, shapely.points(shapely.get_coordinates(inside)))
        return (float(shares.min()) / length, float(shares.max()) / length) if length > 0.0 else (0.0, 1.0)

    def _grid(self, members: Ints) -> _Grid:
        bounds = shapely.bounds(self._outer[members])
        low, high = bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)
        cell = max(_SMALLEST_CELL, math.sqrt(float(np.prod(high - low)) / _MOST_CELLS))
        columns, lines = (math.ceil(float(extent) / cell) + 1 for extent in high - low)
        cells, zones, depths = [], [], []
        for zone, box in zip(members.tolist(), bounds, strict=True):
            x0, y0 = np.floor((box[:2] - low) / cell).astype(int)
            x1, y1 = np.floor((box[2:] - low) / cell).astype(int)
            column, line = (part.ravel() for part in np.meshgrid(np.arange(x0, x1 + 1), np.arange(y0, y1 + 1)))
            left, bottom = low[0] + column * cell, low[1] + line * cell
            # A hair larger than the cell: a point that rounds into it lies in this box.
            hair = 1e-9 * (1.0 + float(np.abs(bounds).max()))
            boxes = shapely.box(left - hair, bottom - hair, left + cell + hair, bottom + cell + hair)
            near = np.flatnonzero(shapely.intersects(self._outer[zone], boxes))
            boxes = boxes[near]
            depth = np.full(len(near), _MIXED, np.int8)
            outside = ~shapely.intersects(self._zones[zone], boxes)
            depth[outside & shapely.contains_properly(self._outer[zone], boxes)] = BAND
            within = shapely.contains_properly(self._zones[zone], boxes)
            depth[within & ~shapely.intersects(self._core[zone], boxes)] = WITHIN
            depth[within & shapely.contains_properly(self._core[zone], boxes)] = CORE
            cells.append(line[near] * columns + column[near])
            zones.append(np.full(len(near), zone))
            depths.append(depth)
        cell_of, zone_of, depth_of = np.concatenate(cells), np.concatenate(zones), np.concatenate(depths)
        order = np.argsort(cell_of, kind="stable")
        start = np.zeros(columns * lines + 1, np.int64)
        np.cumsum(np.bincount(cell_of, minlength=columns * lines), out=start[1:])
        return _Grid((float(low[0]), float(low[1])), cell, (lines, columns), start, zone_of[order], depth_of[order])


def _buffered(zones: NDArray[np.object_], distance: float) -> NDArray[np.object_]:
    """Grow or shrink every zone; a fresh array, because preparing changes the polygons."""
    return np.array(list(shapely.buffer(zones, distance, quad_segs=16)), dtype=object)


def _lines(segments: Floats) -> NDArray[np.object_]:
    lines: NDArray[np.object_] = np.asarray(shapely.linestrings(segments), dtype=object).reshape(-1)
    return lines
