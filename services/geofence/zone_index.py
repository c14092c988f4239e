"""How deep does each of many points lie in each border nearby, and which borders does a step cut?

A *border* is the ring of an area or a directed line. Depth is the signed distance to it, metres: positive inside of an
area and left of a line, exact near the border. A grid of cells per floor lists the borders that come within ``reach``
of each cell and the few edges that can be the nearest there, so that a point is measured against two edges or three, by
arrays, and not against every zone. Steps longer than ``reach`` go to an R-tree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

__all__ = ["ZoneIndex"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
Box = tuple[float, float, float, float]

_SMALLEST_CELL = 0.25
_MOST_CELLS = 65536
_AT_ONCE = 2**21
"""Distances of cells to edges computed at once while a grid is built."""
_TIE = 1e-9
"""m²: of two edges that meet in the nearest corner the one that faces the point decides on which side it is."""


@dataclass(frozen=True)
class _Grid:
    """Cells of one floor in rows from ``origin``; cell c lists entries ``start[c]`` to ``start[c + 1]``.

    Entry e is of border ``border[e]`` with the edges ``edge[first[e]:first[e + 1]]``; no edges: deep inside.
    """

    origin: tuple[float, float]
    cell: float
    shape: tuple[int, int]
    start: Ints
    border: Ints
    first: Ints
    edge: Ints


class ZoneIndex:
    """The borders of one site.

    Args:
        points: corners (x, y) of each border, metres: of an area its ring, of a line its course.
        floors: the floor of each border.
        reach: metres within which depths are exact; whoever is farther outside is not listed.
        lines: whether each border is a line; None: all are areas.
        bounds: floors' (low x, low y, high x, high y), beyond which nobody is looked for; other floors have none.
    """

    def __init__(
        self,
        points: Sequence[Sequence[tuple[float, float]]],
        floors: Sequence[str],
        reach: float,
        lines: Sequence[bool] | None = None,
        bounds: dict[str, Box] | None = None,
    ) -> None:
        self.reach = reach
        count = len(points)
        self.is_line: Bools = np.zeros(count, np.bool_) if lines is None else np.array(lines, np.bool_)
        """(borders,) whether each is a line."""
        courses = [
            np.array(course, float) if line else _closed(course)
            for course, line in zip(points, self.is_line.tolist(), strict=True)
        ]
        self._shapes: NDArray[np.object_] = np.empty(count, object)
        self._shapes[:] = [
            shapely.LineString(course) if line else shapely.Polygon(course)
            for course, line in zip(courses, self.is_line.tolist(), strict=True)
        ]
        self._floor_numbers = {name: number for number, name in enumerate(dict.fromkeys([*(bounds or {}), *floors]))}
        self.floor_names = {number: name for name, number in self._floor_numbers.items()}
        """Of the floor numbers."""
        self.floor = np.array([self._floor_numbers[name] for name in floors], np.int64)
        """(borders,) number of each border's floor."""
        self.half_width = _half_widths(self._shapes, self.is_line)
        """(borders,) metres, about half of how wide each area is where it is narrow; infinite for lines."""
        self._edges_first = np.zeros(count + 1, np.int64)
        np.cumsum([len(course) - 1 for course in courses], out=self._edges_first[1:])
        begin = np.concatenate([course[:-1] for course in courses]) if courses else np.empty((0, 2))
        along = (np.concatenate([course[1:] for course in courses]) if courses else np.empty((0, 2))) - begin
        length = np.hypot(along[:, 0], along[:, 1])
        self._ax, self._ay, self._ux, self._uy = begin[:, 0], begin[:, 1], along[:, 0], along[:, 1]
        self._inverse = 1.0 / np.maximum(length, 1e-12)
        self._shapely_tree: shapely.STRtree | None = None
        self._grids = [
            self._grid(members, (bounds or {}).get(name)) if len(members) else None
            for name, number in self._floor_numbers.items()
            for members in [np.flatnonzero(self.floor == number)]
        ]

    def __len__(self) -> int:
        return len(self._shapes)

    def floors_of(self, names: Sequence[str]) -> Ints:
        """Return the numbers of these floors, (n,); -1 for a floor that is not known."""
        numbers = self._floor_numbers
        return np.fromiter((numbers.get(name, -1) for name in names), np.int64, len(names))

    def nearby(self, x: Floats, y: Floats, floor: Ints) -> tuple[Ints, Ints, Floats, Ints]:
        """Return the pairs of a point and a border that is not surely farther than ``reach`` outside.

        Args:
            x: (n,) metres.
            y: (n,) metres.
            floor: (n,) floor numbers.

        Returns:
            row: (m,) which point.
            border: (m,) which border; each pair comes once.
            depth: (m,) metres; ``reach`` where it is surely more.
            edge: (m,) the nearest edge, for ``normals``; -1 where the depth is ``reach``.
        """
        found = [
            self._nearby(grid, np.flatnonzero(floor == number), x, y)
            for number, grid in enumerate(self._grids)
            if grid is not None
        ]
        if len(found) == 1:
            return found[0]
        if not found:
            none = np.empty(0, np.int64)
            return none, none, np.empty(0), none
        row, border, depth, edge = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return row, border, depth, edge

    def normals(self, edge: Ints) -> tuple[Floats, Floats]:
        """Return the unit normals (k,), (k,) of edges; of -1 something."""
        inverse = self._inverse[edge]
        return -self._uy[edge] * inverse, self._ux[edge] * inverse

    def depth(self, border: Ints, x: Floats, y: Floats) -> Floats:
        """Return the exact depth (m,) of each point in the border beside it, however far."""
        edge, first = self._edges_of(border)
        of = np.repeat(np.arange(len(border)), np.diff(first))
        return self._measure(edge, first[:-1], of, x, y)[0]

    def beside(self, border: Ints, x: Floats, y: Floats) -> Floats:
        """Return how far (m,) left of the border beside it each point lies, were its nearest edge without ends."""
        edge, first = self._edges_of(border)
        nearest = self._measure(edge, first[:-1], np.repeat(np.arange(len(border)), np.diff(first)), x, y)[1]
        dx, dy = x - self._ax[nearest], y - self._ay[nearest]
        left: Floats = (self._ux[nearest] * dy - self._uy[nearest] * dx) * self._inverse[nearest]
        return left

    def clear_of_borders(self, x: Floats, y: Floats, floor: Ints, radius: Floats) -> Bools:
        """Whether each of (n,) discs of so many metres crosses no border of its floor."""
        clear = np.ones(len(x), np.bool_)
        here = np.flatnonzero(floor >= 0)
        if len(here) and len(self):
            discs = shapely.points(x[here], y[here])
            row, border = self._tree.query(discs, predicate="dwithin", distance=radius[here])
            row, border = row[self.floor[border] == floor[here][row]], border[self.floor[border] == floor[here][row]]
            at = here[row]
            # An area is also near to whoever is inside of it: what counts is its ring.
            near = np.abs(self.depth(border.astype(np.int64), x[at], y[at])) <= radius[at]
            clear[at[near]] = False
        return clear

    def cut(self, segments: Floats, floor: Ints) -> tuple[Ints, Ints]:
        """Return the pairs of one of (k, 2, 2) segments and a border of its floor that touch: (pairs,) each."""
        row, border = self._tree.query(_lines(segments), predicate="intersects")
        same = self.floor[border] == floor[row]
        return row[same].astype(np.int64), border[same].astype(np.int64)

    def crossed(self, border: Ints, segments: Floats) -> tuple[Ints, Bools, Floats]:
        """Say how each of (m, 2, 2) segments crosses the border beside it.

        Returns:
            net: (m,) how often from left to right less how often from right to left (of areas: out less in).
            any: (m,) whether it crosses at all.
            share: (m,) of the segment's length at which it crosses last; 1 where it does not.
        """
        edge, first = self._edges_of(border)
        of = np.repeat(np.arange(len(border)), np.diff(first))
        start, step = segments[of, 0], segments[of, 1] - segments[of, 0]
        dx, dy = start[:, 0] - self._ax[edge], start[:, 1] - self._ay[edge]
        ux, uy = self._ux[edge], self._uy[edge]
        before, after = ux * dy - uy * dx, ux * (dy + step[:, 1]) - uy * (dx + step[:, 0])
        begin, end = step[:, 0] * -dy - step[:, 1] * -dx, step[:, 0] * (uy - dy) - step[:, 1] * (ux - dx)
        through = ((before >= 0) != (after >= 0)) & ((begin >= 0) != (end >= 0))
        change = np.where(through, np.where(before >= 0, 1, -1), 0)
        share = np.where(through, before / np.where(through, before - after, 1.0), -np.inf)
        net = np.add.reduceat(change, first[:-1]) if len(border) else np.empty(0, np.int64)
        last = np.maximum.reduceat(share, first[:-1]) if len(border) else np.empty(0)
        return net.astype(np.int64), np.isfinite(last), np.where(np.isfinite(last), last, 1.0)

    def chord(self, border: int, ways: Floats) -> tuple[float, float] | None:
        """Return where the first of (w, k, 2) ways enters and leaves an area, as shares of its length.

        None where any of them does not.
        """
        if not bool(np.all(shapely.intersects(self._shapes[border], _lines(ways)))):
            return None
        line = shapely.LineString(ways[0])
        inside = shapely.intersection(self._shapes[border], line)
        length = float(line.length)
        shares = shapely.line_locate_point(line, shapely.points(shapely.get_coordinates(inside)))
        return (float(shares.min()) / length, float(shares.max()) / length) if length > 0.0 else (0.0, 1.0)

    def representative(self, border: int) -> tuple[float, float]:
        """Return a point in the area, or on the line."""
        point = self._shapes[border].representative_point()
        return float(point.x), float(point.y)

    @property
    def _tree(self) -> shapely.STRtree:
        if self._shapely_tree is None:
            self._shapely_tree = shapely.STRtree(self._shapes)
        return self._shapely_tree

    def _nearby(self, grid: _Grid, rows: Ints, x: Floats, y: Floats) -> tuple[Ints, Ints, Floats, Ints]:
        column = np.floor((x[rows] - grid.origin[0]) / grid.cell)
        line = np.floor((y[rows] - grid.origin[1]) / grid.cell)
        on_grid = (column >= 0) & (line >= 0) & (column < grid.shape[1]) & (line < grid.shape[0])
        rows = rows[on_grid]
        cell = line[on_grid].astype(np.int64) * grid.shape[1] + column[on_grid].astype(np.int64)
        first = grid.start[cell]
        count = grid.start[cell + 1] - first
        row, entry = np.repeat(rows, count), _ranges(first, count)
        depth, nearest = np.full(len(row), self.reach), np.full(len(row), -1, np.int64)
        edges = grid.first[entry + 1] - grid.first[entry]
        measured = np.flatnonzero(edges)
        if len(measured):
            count = edges[measured]
            edge = grid.edge[_ranges(grid.first[entry[measured]], count)]
            starts = np.cumsum(count) - count
            of = np.repeat(row[measured], count)
            depth[measured], nearest[measured] = self._measure(edge, starts, of, x, y)
        return row, grid.border[entry], depth, nearest

    def _measure(self, edge: Ints, starts: Ints, of: Ints, x: Floats, y: Floats) -> tuple[Floats, Ints]:
        """Return signed distance and nearest edge of groups of edges that begin at ``starts``; ``of``: their point."""
        if not len(edge):
            return np.empty(0), np.empty(0, np.int64)
        ux, uy, inverse = self._ux[edge], self._uy[edge], self._inverse[edge]
        dx, dy = x[of] - self._ax[edge], y[of] - self._ay[edge]
        share = np.clip((dx * ux + dy * uy) * inverse * inverse, 0.0, 1.0)
        facing = (ux * dy - uy * dx) * inverse
        square = (dx - share * ux) ** 2 + (dy - share * uy) ** 2
        if len(starts) == len(edge):
            return np.copysign(np.sqrt(square), facing), edge
        score = square - _TIE * np.abs(facing) / (1.0 + np.abs(facing))
        size = np.diff(np.append(starts, len(edge)))
        best = np.flatnonzero(score == np.repeat(np.minimum.reduceat(score, starts), size))
        group = np.repeat(np.arange(len(starts)), size)[best]
        best = best[np.flatnonzero(np.append(True, group[1:] != group[:-1]))]
        return np.copysign(np.sqrt(square[best]), facing[best]), edge[best]

    def _edges_of(self, border: Ints) -> tuple[Ints, Ints]:
        """Return all edges of each border, one after the other, and where each begins (m + 1,)."""
        count = self._edges_first[border + 1] - self._edges_first[border]
        first = np.zeros(len(border) + 1, np.int64)
        np.cumsum(count, out=first[1:])
        return _ranges(self._edges_first[border], count), first

    def _grid(self, members: Ints, bounds: Box | None) -> _Grid:
        boxes = shapely.bounds(self._shapes[members]) + self.reach * np.array([-1.0, -1.0, 1.0, 1.0])
        low, high = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
        if bounds is not None:
            low = np.clip(low, bounds[:2], bounds[2:])
            high = np.clip(high, bounds[:2], bounds[2:])
        cell = max(_SMALLEST_CELL, math.sqrt(float(np.prod(high - low)) / _MOST_CELLS))
        columns, lines = (math.ceil(float(extent) / cell) + 1 for extent in high - low)
        # Half a cell's diagonal, and a hair: a point that rounds into a cell lies this near to its centre.
        half = cell * math.sqrt(0.5) + 1e-9 * (1.0 + float(np.abs(boxes).max()))
        cells, borders, counts, edges = [], [], [], []
        for border, box in zip(members.tolist(), boxes, strict=True):
            x0, y0 = np.clip(np.floor((box[:2] - low) / cell), 0, (columns, lines)).astype(int)
            x1, y1 = np.clip(np.floor((box[2:] - low) / cell), -1, (columns - 1, lines - 1)).astype(int)
            if x1 < x0 or y1 < y0:
                continue
            at = (np.arange(y0, y1 + 1)[:, None] * columns + np.arange(x0, x1 + 1)).ravel()
            some = max(1, _AT_ONCE // int(self._edges_first[border + 1] - self._edges_first[border]))
            for part in (at[begin : begin + some] for begin in range(0, len(at), some)):
                x, y = low[0] + (part % columns + 0.5) * cell, low[1] + (part // columns + 0.5) * cell
                listed, count, edge = self._listed(border, x, y, half)
                cells.append(part[listed])
                borders.append(np.full(len(listed), border))
                counts.append(count)
                edges.append(edge)
        none = [np.empty(0, np.int64)]
        cell_of, border_of, count_of, edge_of = (np.concatenate(p or none) for p in (cells, borders, counts, edges))
        order = np.argsort(cell_of, kind="stable")
        start = np.zeros(columns * lines + 1, np.int64)
        np.cumsum(np.bincount(cell_of, minlength=columns * lines), out=start[1:])
        first = np.zeros(len(order) + 1, np.int64)
        np.cumsum(count_of[order], out=first[1:])
        edge_of = edge_of[_ranges((np.cumsum(count_of) - count_of)[order], count_of[order])]
        return _Grid((float(low[0]), float(low[1])), cell, (lines, columns), start, border_of[order], first, edge_of)

    def _listed(self, border: int, x: Floats, y: Floats, half: float) -> tuple[Ints, Ints, Ints]:
        """Return which cells with centres (c,) list a border, how many of its edges each, and the edges."""
        edge = np.arange(self._edges_first[border], self._edges_first[border + 1])
        ux, uy, inverse = self._ux[edge], self._uy[edge], self._inverse[edge]
        dx, dy = x[:, None] - self._ax[edge], y[:, None] - self._ay[edge]
        share = np.clip((dx * ux + dy * uy) * inverse * inverse, 0.0, 1.0)
        distance = np.hypot(dx - share * ux, dy - share * uy)
        nearest = distance.min(axis=1)
        depth = self.depth(np.full(len(x), border), x, y)
        near = nearest <= self.reach + half
        deep = ~near & (depth > 0.0) & ~self.is_line[border]
        listed = np.flatnonzero(near | deep)
        can_be_nearest = (distance[listed] <= nearest[listed, None] + 2.0 * half) & near[listed, None]
        return listed, can_be_nearest.sum(axis=1), edge[np.nonzero(can_be_nearest)[1]]


def _closed(ring: Sequence[tuple[float, float]]) -> Floats:
    """Return a ring counter-clockwise, so that inside is left of it, its first corner once more at the end."""
    corners = np.array(ring, float)
    if np.array_equal(corners[0], corners[-1]):
        corners = corners[:-1]
    if not shapely.LinearRing(corners).is_ccw:
        corners = corners[::-1]
    return np.concatenate([corners, corners[:1]])


def _half_widths(shapes: NDArray[np.object_], is_line: Bools) -> Floats:
    """Area over circumference: half of the width of a strip, a quarter of that of a square."""
    length: Floats = np.asarray(shapely.length(shapes), float)
    return np.where(is_line, np.inf, np.asarray(shapely.area(shapes), float) / np.maximum(length, 1e-12))


def _ranges(first: Ints, count: Ints) -> Ints:
    """Return first[i] .. first[i] + count[i] - 1, one after the other."""
    end = np.cumsum(count)
    return np.arange(int(end[-1]) if len(end) else 0) + np.repeat(first - end + count, count)


def _lines(segments: Floats) -> NDArray[np.object_]:
    lines: NDArray[np.object_] = np.asarray(shapely.linestrings(segments), dtype=object).reshape(-1)
    return lines
