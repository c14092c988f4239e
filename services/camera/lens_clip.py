"""What does the lens do to straight lines? From a clip in which a checkerboard is moved before the camera.

Zhang's method as OpenCV has it, with k1 and k2: what security lenses need, and few enough for twenty views.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from services.camera.checkerboard import find_board
from services.camera.detector import Image
from shared.site.site_file import Lens

__all__ = ["LensClipError", "LensFit", "calibrate_lens", "collect_views"]

FEWEST = 8
"""Views with the board."""
MOST = 40
APART = 0.05
"""By which share of the picture's width the board must have moved for a view to count as another."""
COVERED = 0.35
"""Share of the picture's width and height that the views must reach over together: the lens bends at the edges."""
LARGEST_ERROR = 2.0
"""Pixels."""

Views = list[NDArray[np.float64]]


class LensClipError(ValueError):
    """No lens comes of this clip: the text says why, and what to do."""


@dataclass(frozen=True)
class LensFit:
    """A lens and how well it explains the views.

    Attributes:
        lens: ready for the site.
        views: how many views were used.
        error: root mean square distance in the picture, pixels.
        straight_error: the same without k1 and k2.
    """

    lens: Lens
    views: int
    error: float
    straight_error: float


def collect_views(images: Iterable[Image], columns: int, rows: int) -> tuple[Views, tuple[int, int]]:
    """Return the board's corners (columns · rows, 2) of up to ``MOST`` views that differ, and the pictures' size.

    Raises:
        LensClipError: the clip is empty, or pictures change their size.
        ValueError: there is no such board.
    """
    views: Views = []
    size: tuple[int, int] | None = None
    for image in images:
        now = (image.shape[1], image.shape[0])
        if size is not None and now != size:
            raise LensClipError(f"the clip changes its size from {size[0]} x {size[1]} to {now[0]} x {now[1]}")
        size = now
        corners = find_board(image, columns, rows)
        if corners is None:
            continue
        moved = [float(np.mean(np.linalg.norm(corners - view, axis=1))) for view in views]
        if not moved or min(moved) > APART * size[0]:
            views.append(corners)
            if len(views) == MOST:
                break
    if size is None:
        raise LensClipError("the clip holds no picture")
    return views, size


def calibrate_lens(views: Sequence[NDArray[np.float64]], size: tuple[int, int], columns: int, rows: int) -> LensFit:
    """Return the lens that explains the views best.

    Args:
        views: each (columns · rows, 2) pixels, row by row.
        size: width and height of the pictures.
        columns: inner corners in a row.
        rows: rows of them.

    Raises:
        LensClipError: too few views, all alike, or nothing sensible explains them.
    """
    if len(views) < FEWEST:
        raise LensClipError(
            f"the board is seen whole in {len(views)} views that differ; at least {FEWEST} are needed: move it slowly "
            "through the whole picture, near and far, tilted this way and that"
        )
    every = np.concatenate(list(views))
    reach = np.ptp(every, axis=0) / size
    if reach.min() < COVERED:
        raise LensClipError(
            f"the board was shown in {100 * reach[0]:.0f} % of the picture's width and {100 * reach[1]:.0f} % of its "
            "height; "
            f"at least {100 * COVERED:.0f} % are needed: the lens bends most at the edges, show it there too"
        )
    board = np.zeros((columns * rows, 3), np.float32)
    board[:, :2] = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    boards = [board] * len(views)
    images = [view.astype(np.float32).reshape(-1, 1, 2) for view in views]
    straight = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
    try:
        plain = cv2.calibrateCamera(
            boards, images, size, None, None, flags=straight | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2
        )
        error, matrix, coefficients, *_ = cv2.calibrateCamera(boards, images, size, None, None, flags=straight)
    except cv2.error as reason:
        raise LensClipError(f"nothing explains these views: {reason.err}") from reason
    if not error < LARGEST_ERROR:
        raise LensClipError(
            f"the best lens leaves {error:.1f} px (allowed: below {LARGEST_ERROR:g}): was the board bent or blurred, "
            "the lens zoomed meanwhile, or is it a fisheye?"
        )
    k1, k2 = (float(value) for value in coefficients.ravel()[:2])
    lens = Lens(
        image_size=size,
        focal=(float(matrix[0, 0]), float(matrix[1, 1])),
        centre=(float(matrix[0, 2]), float(matrix[1, 2])),
        k1=k1,
        k2=k2,
    )
    return LensFit(lens, len(views), float(error), float(plain[0]))
