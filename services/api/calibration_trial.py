"""What comes of some pairs: a fitted camera, how far off each pair is, what that means in words. Nothing is stored."""

from __future__ import annotations

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from services.api.calibration_replies import (
    CalibrationTrial,
    CalibrationTry,
    GridLineView,
    PairReport,
)
from shared.site import Floor
from shared.site.calibration import FROM, Calibration, calibrate
from shared.site.camera_geometry import LensModel
from shared.site.floor_grid import floor_grid
from shared.site.floor_marks import board_places, rectangle_places
from shared.site.footprint import footprint

__all__ = ["all_pairs", "try_pairs"]

BOARD_SIDE = 4
"""Corners of a checkerboard that are taken in each direction: more of one small board say no more."""
GOOD = 0.1
"""Metres within which a calibration is called good."""
OUTSIDE = 1.0
"""Metres beyond the floor's outline from which a place is thought to be a slip."""

Array = NDArray[np.float64]


def all_pairs(order: CalibrationTry) -> tuple[Array, Array]:
    """Return pixels (n, 2) and places (n, 2) of the clicked pairs, of rectangles and of checkerboards.

    Raises:
        ValueError: a board has another number of corners than it says.
    """
    image = [np.array([pair.pixel for pair in order.pairs], float).reshape(-1, 2)]
    plan = [np.array([pair.place for pair in order.pairs], float).reshape(-1, 2)]
    for mark in order.rectangles:
        image.append(np.array(mark.pixels, float))
        plan.append(rectangle_places(mark.corner, math.radians(mark.angle), mark.width, mark.depth))
    for number, board in enumerate(order.boards):
        if len(board.pixels) != board.columns * board.rows:
            raise ValueError(
                f"boards[{number}].pixels: {len(board.pixels)} corners; "
                f"allowed: columns x rows, {board.columns * board.rows}"
            )
        pixels = np.array(board.pixels, float)
        angle = math.radians(board.angle)
        places = board_places(board.corner, angle, board.columns, board.rows, board.square, pixels)
        taken = np.ix_(_spread(board.rows), _spread(board.columns))
        for target, corners in ((image, pixels), (plan, places)):
            target.append(corners.reshape(board.rows, board.columns, 2)[taken].reshape(-1, 2))
    return np.concatenate(image), np.concatenate(plan)


def try_pairs(
    camera: str, floor: Floor, image_size: tuple[int, int], image: Array, plan: Array, lens: LensModel | None
) -> CalibrationTrial:
    """Return the camera that fits, and what to know of it.

    Args:
        camera: its id.
        floor: what it looks at.
        image_size: pixels.
        image: (n, 2).
        plan: (n, 2) metres.
        lens: where it is calibrated.

    Raises:
        GeometryError: none does; the text says why.
    """
    found = calibrate(image_size, image, plan, lens)
    outline = floor.plan().outline
    step, grid = floor_grid(found.geometry, outline.bounds)
    alone = found.alone_metres[found.used & np.isfinite(found.alone_metres)]
    x, y, z = (round(float(value), 3) for value in found.geometry.position)
    width = image_size[0]
    return CalibrationTrial(
        camera=camera,
        pairs=[_report(found, image, plan, row) for row in range(len(image))],
        median_metres=float(np.median(found.off_metres[found.used])),
        median_alone_metres=float(np.median(alone)) if len(alone) else None,
        position=(x, y, z),
        horizontal_fov=math.degrees(2.0 * math.atan(width / 2.0 / found.geometry.focal[0])),
        lens=lens is not None,
        words=_words(found, plan, alone, floor),
        step=step,
        grid=[GridLineView(axis=line.axis, at=line.at, pixels=line.pixels) for line in grid],
        footprint=footprint(found.geometry, None, outline),
    )


def _report(found: Calibration, image: Array, plan: Array, row: int) -> PairReport:
    def number(value: float) -> float | None:
        return round(float(value), 4) if math.isfinite(value) else None

    def point(place: Array) -> tuple[float, float] | None:
        return (round(float(place[0]), 3), round(float(place[1]), 3)) if np.isfinite(place).all() else None

    return PairReport(
        pixel=(float(image[row, 0]), float(image[row, 1])),
        place=(float(plan[row, 0]), float(plan[row, 1])),
        used=bool(found.used[row]),
        off_pixels=number(found.off_pixels[row]),
        off_metres=number(found.off_metres[row]),
        alone_metres=number(found.alone_metres[row]),
        shown=point(found.pixels[row]),
        seen=point(found.plan[row]),
    )


def _words(found: Calibration, plan: Array, alone: Array, floor: Floor) -> list[str]:
    words = []
    if found.suspect is not None:
        off = found.off_metres[found.suspect]
        how = f"{off:.2f} m off" if math.isfinite(off) else "where the camera sees no floor"
        words.append(
            f"Pair {found.suspect + 1} is taken for a wrong click and left out: it is {how}, and without it the others "
            "agree."
        )
    place = found.geometry.position
    words.append(
        f"The camera would hang {place[2]:.2f} m above the floor, over ({place[0]:.1f}, {place[1]:.1f}) of the plan."
    )
    if len(found.used) < FROM:
        words.append(f"With {len(found.used)} pairs a wrong click bends everything unseen: click {FROM} or more.")
    elif len(alone):
        worth = float(np.median(alone))
        judged = (
            "good" if worth <= GOOD else "fair: more pairs, spread wider, make it better" if worth <= 0.3 else "poor"
        )
        words.append(f"Where nobody clicked it is about {100 * worth:.0f} cm off: {judged}.")
    middle = float(np.median(found.off_metres[found.used]))
    if len(found.used) >= FROM and len(alone) and middle > 0.3:
        words.append("So far off means measures that do not fit, a sloping floor, or a lens to be calibrated.")
    outline = floor.plan().outline.buffer(OUTSIDE)
    outside = [str(row + 1) for row in np.flatnonzero(~shapely.intersects_xy(outline, plan[:, 0], plan[:, 1]))]
    if outside:
        words.append(f"Outside of the floor's outline: pair {', '.join(outside)}.")
    return words


def _spread(count: int) -> NDArray[np.intp]:
    """Up to ``BOARD_SIDE`` of so many indices, first and last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, BOARD_SIDE)).round().astype(np.intp))
