"""Where are the inner corners of a checkerboard in a picture?"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from services.camera.detector import Image

__all__ = ["find_board"]

LEAST, MOST = 3, 30
LARGEST = 1600
"""Pixels: the search is done on a picture no longer than this, the corners are refined on the whole one."""


def find_board(image: Image, columns: int, rows: int) -> NDArray[np.float64] | None:
    """Return the corners (columns · rows, 2) in pixels, row by row, or None where the board is not seen whole.

    Args:
        image: (height, width, 3), blue-green-red.
        columns: inner corners in a row: one less than squares.
        rows: rows of them.

    Raises:
        ValueError: there is no such board.
    """
    for name, value in (("columns", columns), ("rows", rows)):
        if not LEAST <= value <= MOST:
            raise ValueError(f"{name}: found {value}; allowed: {LEAST} to {MOST} inner corners")
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    scale = min(LARGEST / max(grey.shape), 1.0)
    small = grey if scale == 1.0 else cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    found, corners = cv2.findChessboardCorners(small, (columns, rows), flags=flags)
    if not found:
        return None
    corners = ((corners.astype(np.float32) + 0.5) / scale - 0.5).astype(np.float32)
    grid = corners.reshape(rows, columns, 2)
    apart = min(
        float(np.min(np.linalg.norm(np.diff(grid, axis=0), axis=2))),
        float(np.min(np.linalg.norm(np.diff(grid, axis=1), axis=2))),
    )
    # A window that reaches the next corner is drawn to that one.
    window = max(2, min(11, int(0.4 * apart)))
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
    refined = cv2.cornerSubPix(grey, corners, (window, window), (-1, -1), stop)
    return np.asarray(refined, np.float64).reshape(-1, 2)
