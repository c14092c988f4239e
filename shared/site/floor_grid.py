"""What does a grid of metres on the floor look like in a camera's picture? Lines to lay over it and judge by eye."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from shared.site.camera_geometry import CameraGeometry

__all__ = ["GridLine", "floor_grid"]

MOST_LINES = 60
"""In each direction."""
SAMPLES = 240


@dataclass(frozen=True)
class GridLine:
    """One line of the grid where it is in the picture.

    Attributes:
        axis: which coordinate is the same all along it.
        at: that coordinate, metres.
        pixels: one or more stretches of points, each [(u, v), …].
    """

    axis: Literal["x", "y"]
    at: float
    pixels: list[list[tuple[float, float]]]


def floor_grid(geometry: CameraGeometry, bounds: tuple[float, float, float, float]) -> tuple[float, list[GridLine]]:
    """Return the distance of the lines in metres (1, 2, 5 …) and those that are in the picture.

    Args:
        geometry: the camera.
        bounds: the floor to cover: left, bottom, right, top, metres.
    """
    left, bottom, right, top = bounds
    longest = max(right - left, top - bottom)
    step = next(
        size * 10.0**power for power in range(6) for size in (1, 2, 5) if longest <= MOST_LINES * size * 10**power
    )
    lines = []
    for axis, (first, last), (start, end) in (("x", (left, right), (bottom, top)), ("y", (bottom, top), (left, right))):
        along = np.linspace(start, end, SAMPLES)
        for at in np.arange(np.ceil(first / step), np.floor(last / step) + 1) * step:
            fixed = np.full(SAMPLES, at)
            plan = np.column_stack([fixed, along] if axis == "x" else [along, fixed])
            stretches = _in_picture(geometry, plan)
            if stretches:
                lines.append(GridLine("x" if axis == "x" else "y", float(at), stretches))
    return step, lines


def _in_picture(geometry: CameraGeometry, plan: NDArray[np.float64]) -> list[list[tuple[float, float]]]:
    width, height = geometry.image_size
    pixels = geometry.to_image(np.column_stack([plan, np.zeros(len(plan))]))
    with np.errstate(invalid="ignore"):
        # A margin, so that lines reach the picture's edge; what is drawn beyond it is cut off.
        margin = 0.25 * max(width, height)
        inside = np.all((pixels > -margin) & (pixels < np.array([width, height]) + margin), axis=1)
        shown = np.atleast_1d(np.all((pixels >= 0) & (pixels < [width, height]), axis=1))
    borders = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
    return [
        [(round(float(u), 1), round(float(v), 1)) for u, v in pixels[begin:end]]
        for begin, end in borders.reshape(-1, 2).tolist()
        if end - begin > 1 and shown[begin:end].any()
    ]
