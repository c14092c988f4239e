"""People do not walk through walls: how far does a step get, and where does it end [ravel-thesis §8.5]?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.fusion.forces.obstacles import Obstacles

__all__ = ["stay_walkable", "walkable_share"]

Array = NDArray[np.float64]

GAP = 0.05
"""Metres before a wall at which a step ends."""


def walkable_share(start: Array, end: Array, obstacles: Obstacles) -> Array:
    """Return (n,) which share of the way from (n, 2) ``start`` to (n, 2) ``end`` is free of walls and edges: 0 to 1.

    A way that starts inside a solid, where an estimate may lie, is free.
    """
    return obstacles.first_crossing(start, end)[0]


def stay_walkable(start: Array, end: Array, obstacles: Obstacles) -> Array:
    """Return (n, 2) where steps from (n, 2) ``start`` towards (n, 2) ``end`` get without crossing walls.

    A step ends ``GAP`` before the first wall and goes on along it with what is left of the step in that direction, up
    to the next wall.
    """
    stop, hit, rest = _stopped(start, end, obstacles)
    if len(hit):
        stop[hit], _, _ = _stopped(stop[hit], stop[hit] + rest, obstacles)
    return stop


def _stopped(start: Array, end: Array, obstacles: Obstacles) -> tuple[Array, NDArray[np.int64], Array]:
    """Return (n, 2) where steps stop, which (m,) were stopped and (m, 2) what is left of those along the wall."""
    share, wall = obstacles.first_crossing(start, end)
    hit = np.flatnonzero(wall >= 0)
    stop = end.copy()
    if not len(hit):
        return stop, hit, np.zeros((0, 2))
    move = end[hit] - start[hit]
    along = obstacles.lines[2:4, wall[hit]].T
    # The gap is kept square to the wall, however flat the step meets it.
    square = np.abs(along[:, 0] * move[:, 1] - along[:, 1] * move[:, 0])
    done = np.maximum(share[hit] - GAP / np.maximum(square, 1e-12), 0.0)
    stop[hit] = start[hit] + done[:, None] * move
    left = (1.0 - done) * np.einsum("ni,ni->n", move, along)
    return stop, hit, left[:, None] * along
