"""Where on the plan are the corners of something known that lies on the floor: a rectangle, a checkerboard?

Corners of a rectangle go round it counter-clockwise on the plan, beginning at the corner whose place is told. Those of
a checkerboard go row by row.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["board_places", "rectangle_places"]

Array = NDArray[np.float64]


def rectangle_places(corner: tuple[float, float], angle: float, width: float, depth: float) -> Array:
    """Return the corners (4, 2), metres: the first, along ``width``, across, and back.

    Args:
        corner: where the first lies on the plan, metres.
        angle: direction from the first corner to the second, radians counter-clockwise from +x.
        width: metres from the first to the second.
        depth: metres from the second to the third, to the left of that direction.
    """
    return _placed(np.array([[0.0, 0.0], [width, 0.0], [width, depth], [0.0, depth]]), corner, angle)


def board_places(
    corner: tuple[float, float], angle: float, columns: int, rows: int, square: float, image: Array
) -> Array:
    """Return where the inner corners (columns · rows, 2) of a checkerboard on the floor lie, metres.

    Args:
        corner: where the board's first inner corner lies on the plan, metres.
        angle: direction of its first row, radians counter-clockwise from +x.
        columns: inner corners in a row.
        rows: rows of them.
        square: side of one square, metres.
        image: (columns · rows, 2) the pixels of the corners in the same order. A finder of checkerboards may go through
            the rows either way; a floor is never seen mirrored, so that the pixels tell which.
    """
    across, along = np.meshgrid(np.arange(columns), np.arange(rows))
    corners = np.column_stack([across.ravel(), along.ravel()]).astype(np.float64) * square
    grid = np.asarray(image, float).reshape(rows, columns, 2)
    row, column = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if row[0] * column[1] - row[1] * column[0] > 0.0:  # clockwise on the screen: rows follow to the right of the first
        corners[:, 1] *= -1.0
    return _placed(corners, corner, angle)


def _placed(corners: Array, corner: tuple[float, float], angle: float) -> Array:
    cosine, sine = math.cos(angle), math.sin(angle)
    placed: Array = corners @ np.array([[cosine, sine], [-sine, cosine]]) + np.asarray(corner, float)
    return placed
