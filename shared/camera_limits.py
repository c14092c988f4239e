"""What a camera may be told of what was learned: by learning before it goes live, and by the camera before it obeys."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

__all__ = ["LEARNED_OPTIONS", "UNIT", "alignment_problem", "calibration_problem", "options_problem"]

LEARNED_OPTIONS: dict[str, tuple[float, float]] = {
    "learning_rate": (1e-6, 10.0),
    "sensitivity": (1.001, 200.0),
    "height_scale": (0.5, 2.0),
    "height_scale_right": (-0.5, 0.5),
    "height_scale_down": (-0.5, 0.5),
    "width_scale": (0.5, 2.0),
}
"""The detector options that are learned, with least and largest values, which the foreground detector takes."""
UNIT = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
"""The alignment that corrects nothing."""
FURTHEST = 10.0
"""Metres by which the floor a camera sees may be moved in the median: some knocks on top of each other, no more."""
STRETCH = 2.0
"""Factor by which an alignment may stretch the plan in some direction, or shrink it."""


def options_problem(options: Mapping[str, float]) -> str:
    """Return why these are no learned detector options, as "option: found …; allowed: …"; empty: they are."""
    for name, value in options.items():
        if name not in LEARNED_OPTIONS:
            return f"options: found {name[:64]!r}; allowed: {', '.join(LEARNED_OPTIONS)}"
        least, most = LEARNED_OPTIONS[name]
        if not least <= value <= most:
            return f"options.{name}: found {value:g}; allowed: {least:g} to {most:g}"
    return ""


def calibration_problem(homography: Sequence[float], corrects: str, geometry: str) -> str:
    """Return why an alignment is none of a camera as it is calibrated now; empty: it is.

    Args:
        homography: as for ``alignment_problem``; one that corrects nothing is of every calibration.
        corrects: digest of the calibration it was learned with.
        geometry: digest of the calibration there is.
    """
    if corrects == geometry or tuple(homography) == UNIT:
        return ""
    return "it corrects another calibration of this camera than the one it has now"


def alignment_problem(homography: Sequence[float], floor: Sequence[tuple[float, float]]) -> str:
    """Return why a camera's calibration cannot be corrected so; empty: it can.

    Args:
        homography: 3 x 3 by rows, from the plan as calibrated to the true plan, metres.
        floor: corners (n, 2) of the floor the camera sees, metres; none: not held against it.
    """
    found = f"homography: found ({', '.join(f'{value:g}' for value in homography)})"
    if not all(math.isfinite(value) and abs(value) <= 1e9 for value in homography):
        return f"{found}; allowed: nine finite numbers"
    matrix = np.reshape(np.asarray(homography, float), (3, 3))
    if np.linalg.det(matrix) <= 0.0:
        return f"{found}, which mirrors or flattens the plan; allowed: determinant above 0"
    places = np.asarray(floor, float).reshape(-1, 2)
    if not len(places):
        return ""
    scale = places @ matrix[2, :2] + matrix[2, 2]
    if np.any(scale <= 0.0):
        return f"{found}, which moves floor the camera sees beyond the horizon; allowed: all of it stays before it"
    there = (places @ matrix[:2, :2].T + matrix[:2, 2]) / scale[:, None]
    jacobian = (matrix[:2, :2] - there[:, :, None] * matrix[2, :2]) / scale[:, None, None]
    stretch = np.median(np.linalg.svd(jacobian, compute_uv=False), axis=0)
    if not (stretch[0] <= STRETCH and stretch[1] >= 1.0 / STRETCH):
        return f"{found}, which stretches the plan by {stretch[1]:.3g} to {stretch[0]:.3g}; allowed: 0.5 to 2"
    shift = float(np.median(np.linalg.norm(there - places, axis=1)))
    if not shift <= FURTHEST:
        return f"{found}, which moves the floor the camera sees by {shift:.3g} m; allowed: at most {FURTHEST:g} m"
    return ""
