"""What pushes people away besides people: walls, edges of obstacles and discs, found fast near any place.

Forces add over obstacles, so a wall drawn as many short pieces, or as many blocked cells of a map, must not push many
times [ravel-thesis §7]. A surface therefore pushes from where its distance has a local minimum, and of minima that lie
within 60 degrees of each other only the nearest counts: however finely it was drawn, a straight wall pushes once, the
corner of a room twice. Discs are obstacles of their own, and all push.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from services.fusion.forces.cell_lists import CellLists
from shared.site import FloorPlan

__all__ = ["REACH", "Contacts", "Obstacles", "straight_pieces"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

REACH = 2.0
"""Metres; beyond, a push of the published strength moves nobody by more than a centimetre in a second."""
CELL = 0.5
"""Metres; side of a cell of the index."""
APART = 0.5
"""Cosine of the angle within which only the nearest of several surfaces counts."""


@dataclass(frozen=True)
class Contacts:
    """Which obstacles are within reach of which of n places: m pairs.

    Attributes:
        place: (m,) which place.
        away: (m, 2) unit vector from the obstacle to the place; where the place lies inside a solid, the way out.
        distance: (m,) metres from its nearest point, or from the centre of a disc; negative inside a solid.
        radius: (m,) metres, of a disc; 0 for a surface.
        round: (m,) whether ``away`` turns as the place moves along: not before a straight wall.
    """

    place: Indices
    away: Array
    distance: Array
    radius: Array
    round: NDArray[np.bool_]


@dataclass(frozen=True)
class Obstacles:
    """Straight pieces of surface and discs, with an index of what is near.

    Attributes:
        lines: (5, s) of every piece: x and y of one end, the unit vector to the other end, its length; metres.
        onward: (s, 2, k, 2) unit vectors from each end along the other pieces that meet there; zeros where fewer do.
        solid: (s,) whether the piece bounds something nobody can be in.
        discs: (d, 3) centre and radius, metres.
        inside: what nobody can be in.
        origin: (2,) metres, the lower left corner of the index.
        shape: rows and columns of the index.
        near_pieces: by cell, what may be within reach of a place in it; ``near_discs`` likewise.
        near_discs: see above.
        pieces: all of them as shapes, for ways longer than ``REACH``.
    """

    lines: Array
    onward: Array
    solid: NDArray[np.bool_]
    discs: Array
    inside: BaseGeometry
    origin: Array
    shape: tuple[int, int]
    near_pieces: CellLists
    near_discs: CellLists
    pieces: shapely.STRtree

    @classmethod
    def of_plan(cls, plan: FloorPlan, blocked: shapely.MultiPolygon | None = None) -> Obstacles:
        """Return the walls, the obstacles' edges and the outline of a floor.

        Args:
            plan: the floor.
            blocked: where nobody walks besides, for example ``OcclusionMap.blocked``.
        """
        solids = plan.obstacles if blocked is None else shapely.union_all([plan.obstacles, blocked])
        frame = shapely.box(*plan.outline.buffer(2.0 * REACH).bounds).difference(plan.outline)
        edges = shapely.union_all([shapely.boundary(solids), shapely.boundary(plan.outline)])
        return cls.build(plan.walls, edges, shapely.union_all([solids, frame]))

    @classmethod
    def build(
        cls,
        walls: BaseGeometry | None = None,
        edges: BaseGeometry | None = None,
        inside: BaseGeometry | None = None,
        discs: Array | None = None,
    ) -> Obstacles:
        """Return these obstacles.

        Args:
            walls: lines nobody crosses, metres.
            edges: boundaries of what nobody can be in.
            inside: what nobody can be in.
            discs: (d, 3) centre and radius of round obstacles, metres.
        """
        free, bound = straight_pieces(walls or shapely.MultiLineString()), straight_pieces(edges or shapely.Point())
        ends = np.concatenate([free, bound])
        rounds = np.zeros((0, 3)) if discs is None else np.asarray(discs, dtype=np.float64).reshape(-1, 3)
        spots = np.concatenate([ends.reshape(-1, 2), rounds[:, :2]])
        widest = rounds[:, 2].max(initial=0.0)
        lower = (spots.min(axis=0) if len(spots) else np.zeros(2)) - REACH - widest
        upper = (spots.max(axis=0) if len(spots) else np.zeros(2)) + REACH + widest
        columns, rows = (int(cells) for cells in np.ceil((upper - lower) / CELL))
        x, y = np.meshgrid(lower[0] + CELL * (np.arange(columns) + 0.5), lower[1] + CELL * (np.arange(rows) + 0.5))
        centres = np.column_stack([x.ravel(), y.ravel()])
        far = REACH + 0.75 * CELL  # from a cell's centre, for any place in it
        along = ends[:, 1] - ends[:, 0]
        long = np.linalg.norm(along, axis=1)
        space = inside or shapely.MultiPolygon()
        shapely.prepare(space)
        shapes = [shapely.LineString(piece) for piece in ends]
        return cls(
            lines=np.column_stack([ends[:, 0], along / long[:, None], long]).T.copy(),
            onward=_onward(ends),
            solid=np.arange(len(ends)) >= len(free),
            discs=rounds,
            inside=space,
            origin=lower,
            shape=(rows, columns),
            near_pieces=CellLists.of(shapes, centres, far),
            near_discs=CellLists.of([shapely.Point(x, y) for x, y, _ in rounds], centres, far + widest),
            pieces=shapely.STRtree(shapes),
        )

    def near(self, places: Array) -> Contacts:
        """Return what pushes at each of (n, 2) places, metres."""
        surfaces, discs = self._surfaces(places), self._round(places)
        return Contacts(
            place=np.concatenate([surfaces.place, discs.place]),
            away=np.concatenate([surfaces.away, discs.away]),
            distance=np.concatenate([surfaces.distance, discs.distance]),
            radius=np.concatenate([surfaces.radius, discs.radius]),
            round=np.concatenate([surfaces.round, discs.round]),
        )

    def pieces_near(self, places: Array) -> tuple[Indices, Indices]:
        """Return place and piece of every pair that may be within ``REACH`` of each other, of (n, 2) places."""
        return self.near_pieces.of_cells(self._cells(places))

    def first_crossing(self, start: Array, end: Array) -> tuple[Array, Indices]:
        """Return where ways from (n, 2) ``start`` to (n, 2) ``end`` first cross a piece.

        A way that starts inside a solid, where an estimate may lie, is free: its faces, and walls drawn along them,
        must not keep anybody in. A way that ends exactly on a piece has met it, or the next would start beyond it.

        Returns:
            (n,) the share of each way before it, 1 where nothing is crossed, and (n,) which piece, -1 for none.
        """
        share, wall = np.ones(len(start)), np.full(len(start), -1, np.int64)
        way, piece = self._pieces_along(start, end)
        begin, left = self._beside(start, way, piece)
        stop, right = self._beside(end, way, piece)
        crossing = np.flatnonzero((left * right < 0.0) | ((right == 0.0) & (left != 0.0)))
        way, piece, left, right = way[crossing], piece[crossing], left[crossing], right[crossing]
        part = left / (left - right)
        at = begin[crossing] + part * (stop - begin)[crossing]
        hits = (at >= -1e-9) & (at <= self.lines[4][piece] + 1e-9)
        hits &= ~self._stuck(start, way)[way]
        order = np.flatnonzero(hits)
        order = order[np.lexsort((-part[order], way[order]))]  # the last one written, the nearest, stays
        share[way[order]], wall[way[order]] = part[order], piece[order]
        return share, wall

    def _beside(self, places: Array, place: Indices, piece: Indices) -> tuple[Array, Array]:
        """Return (m,) how far along its piece and (m,) how far left of it each place lies, metres."""
        x, y = places[place, 0] - self.lines[0][piece], places[place, 1] - self.lines[1][piece]
        unit_x, unit_y = self.lines[2][piece], self.lines[3][piece]
        return x * unit_x + y * unit_y, unit_x * y - unit_y * x

    def _pieces_along(self, start: Array, end: Array) -> tuple[Indices, Indices]:
        """Return way and piece of every pair that may cross."""
        long = np.hypot(end[:, 0] - start[:, 0], end[:, 1] - start[:, 1])
        quick = long <= REACH
        way, piece = self.near_pieces.of_cells(np.where(quick, self._cells(start), -1))
        if quick.all():
            return way, piece
        far = np.flatnonzero(~quick & np.isfinite(long))
        # A touch may be lost by rounding: who comes within a micrometre is looked at exactly.
        ways = shapely.linestrings(np.stack([start[far], end[far]], axis=1))
        which, crossed = self.pieces.query(ways, predicate="dwithin", distance=1e-6)
        return np.concatenate([way, far[which]]), np.concatenate([piece, crossed])

    def _cells(self, places: Array) -> Indices:
        """Return (n,) the cell of the index, -1 outside of it."""
        column, row = (places[:, 0] - self.origin[0]) / CELL, (places[:, 1] - self.origin[1]) / CELL
        known = (column >= 0.0) & (column < self.shape[1]) & (row >= 0.0) & (row < self.shape[0])  # false for NaN
        cells = np.full(len(places), -1, np.int64)
        cells[known] = row[known].astype(np.int64) * self.shape[1] + column[known].astype(np.int64)
        return cells

    def _surfaces(self, places: Array) -> Contacts:
        place, piece = self.pieces_near(places)
        x, y = places[place, 0] - self.lines[0][piece], places[place, 1] - self.lines[1][piece]
        unit_x, unit_y, long = (column[piece] for column in self.lines[2:])
        along = x * unit_x + y * unit_y
        share = np.minimum(np.maximum(along, 0.0), long)
        x, y = x - share * unit_x, y - share * unit_y
        distance = np.hypot(x, y)
        near = np.flatnonzero(distance <= REACH)
        place, piece, distance = place[near], piece[near], distance[near]
        apart = np.column_stack([x[near], y[near]])
        # At an end, the distance is least only where it does not fall along the other pieces that meet there.
        last = (along >= long)[near]
        at_end = last | (along <= 0.0)[near]
        ends = np.flatnonzero(at_end)
        falls = np.einsum("mi,mki->mk", apart[ends], self.onward[piece[ends], last[ends].astype(np.int64)]) > 1e-12
        stuck = self._stuck(places, place)
        counts = self.solid[piece] | ~stuck[place]
        counts[ends[falls.any(axis=1)]] = False
        order = np.flatnonzero(counts)
        order = order[np.lexsort((distance[order], place[order]))]
        away = apart / np.maximum(distance, 1e-9)[:, None]
        # Inside a solid there is one way out: through its nearest face.
        order = order[_once_per_direction(place[order], away[order], stuck)]
        sign = np.where(stuck[place[order]], -1.0, 1.0)
        return Contacts(
            place=place[order],
            away=sign[:, None] * away[order],
            distance=sign * distance[order],
            radius=np.zeros(len(order)),
            round=at_end[order],
        )

    def _stuck(self, places: Array, close: Indices) -> NDArray[np.bool_]:
        """Return (n,) which of (n, 2) places lie inside a solid; only those numbered in ``close`` are looked at."""
        stuck = np.zeros(len(places), np.bool_)
        stuck[close] = True
        looked = np.flatnonzero(stuck)
        stuck[looked] = shapely.contains_xy(self.inside, places[looked, 0], places[looked, 1])
        return stuck

    def _round(self, places: Array) -> Contacts:
        place, disc = self.near_discs.of_cells(self._cells(places))
        apart = places[place] - self.discs[disc, :2]
        distance = np.linalg.norm(apart, axis=1)
        kept = distance <= REACH + self.discs[disc, 2]
        return Contacts(
            place=place[kept],
            away=(apart / np.maximum(distance, 1e-9)[:, None])[kept],
            distance=distance[kept],
            radius=self.discs[disc[kept], 2],
            round=np.ones(int(kept.sum()), np.bool_),
        )


def straight_pieces(lines: BaseGeometry) -> Array:
    """Return (s, 2, 2) the longest straight pieces of lines, cut where they cross or meet."""
    # On a grid: pieces shorter than a micrometre would be corners of their own.
    joined = shapely.simplify(shapely.line_merge(shapely.union_all([lines], grid_size=1e-6)), 1e-6)
    parts = [shapely.get_coordinates(part) for part in shapely.get_parts(joined)]
    pieces = [np.stack([line[:-1], line[1:]], axis=1) for line in parts if len(line) > 1]
    return np.concatenate(pieces) if pieces else np.zeros((0, 2, 2))


def _onward(ends: Array) -> Array:
    """Return (s, 2, k, 2) the directions of the other pieces at each end of each piece."""
    tips = np.round(ends.reshape(-1, 2), 6)
    along = ends[:, 1] - ends[:, 0]
    unit = (along / np.linalg.norm(along, axis=1, keepdims=True))[:, None, :] * np.array([1.0, -1.0])[None, :, None]
    heading = unit.reshape(-1, 2)
    _, corner, sizes = np.unique(tips, axis=0, return_inverse=True, return_counts=True)
    corner = corner.reshape(-1)
    most = int(sizes.max(initial=1)) - 1
    onward = np.zeros((len(tips), most, 2))
    for here in np.flatnonzero(sizes > 1):
        met = np.flatnonzero(corner == here)
        for tip in met:
            others = met[met != tip]
            onward[tip, : len(others)] = heading[others]
    return onward.reshape(len(ends), 2, most, 2)


def _once_per_direction(place: Indices, away: Array, alone: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return (m,) which of pairs, sorted by place and distance, count: nothing nearer pushes from about there.

    Args:
        place: (m,) sorted.
        away: (m, 2) unit vectors.
        alone: (n,) places of which only the nearest pair counts.
    """
    kept = np.zeros(len(place), np.bool_)
    left = np.arange(len(place))
    chosen = np.zeros((len(alone), 2))
    while len(left):
        nearest = np.concatenate([[True], place[left[1:]] != place[left[:-1]]])
        kept[left[nearest]] = True
        chosen[place[left[nearest]]] = away[left[nearest]]
        turned = np.einsum("mi,mi->m", away[left], chosen[place[left]])
        left = left[~nearest & (turned <= APART) & ~alone[place[left]]]
    return kept
