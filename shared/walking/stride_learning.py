"""What is somebody's stride line, from lengths that cameras saw [ravel-thesis §8.3]?

Within one walk cadence hardly varies, so that a plain line through (cadence, length) has a slope of noise: on the
mall's traces, a line fitted to the first half of a walk makes the second half worse than the universal model does.
Here the slope is believed to be what people's slopes are until walks at different cadences say otherwise, and a level
that all steps agree about is learned quickly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shared.walking.stride import UNSEEN_SIGMA, USUAL_CADENCE, StrideLine, by_height

__all__ = ["fit_line"]

Array = NDArray[np.float64]

SLOPE, SLOPE_SIGMA = 0.35, 0.10
"""m per step/s, of people."""
PAIR_SIGMA = 0.12
"""m, of one step as a camera sees it against the person's line."""
ALIKE = 6.0
"""Steps in a row err alike: so many are worth one."""
HUBER = 1.5
"""Standard deviations beyond which a pair is an outlier, such as a step of somebody else."""
DAY_SIGMA = 0.03
"""Of a person's steps on another day, as a share; no data makes the line surer than that."""


def fit_line(cadence: Array, length: Array, sigma: float = PAIR_SIGMA, alike: float = ALIKE) -> StrideLine:
    """Return the line of one person, robust and no surer than its data; without data, the prior.

    Args:
        cadence: (n,) steps per second; pairs with a NaN are left out.
        length: (n,) m.
        sigma: m, of one pair.
        alike: pairs in a row that err alike and are worth one.

    Raises:
        ValueError: the two are not equally long.
    """
    if cadence.shape != length.shape:
        raise ValueError(f"length: {length.shape}, cadence has {cadence.shape}; allowed: equally many")
    kept = np.isfinite(cadence) & np.isfinite(length)
    x = np.column_stack([np.ones(int(kept.sum())), cadence[kept] - USUAL_CADENCE])
    y = length[kept]
    usual = float(by_height(np.array(USUAL_CADENCE)))
    prior = np.array([usual, SLOPE])
    certain = np.diag([(UNSEEN_SIGMA * usual) ** -2, SLOPE_SIGMA**-2])
    weight = np.ones(len(y))
    for _ in range(20):
        known = certain + (x.T * weight) @ x / (alike * sigma**2)
        line = np.linalg.solve(known, certain @ prior + (x.T * weight) @ y / (alike * sigma**2))
        off = np.abs(y - x @ line) / sigma
        weight = np.minimum(1.0, HUBER / np.maximum(off, 1e-9))
    level, slope = (float(value) for value in line)
    at = x.mean(axis=0) if len(x) else np.array([1.0, 0.0])  # the cadences it will be used at
    variance = float(at @ np.linalg.solve(known, at) / (at @ line) ** 2) + DAY_SIGMA**2
    return StrideLine(np.array(slope), np.array(level - slope * USUAL_CADENCE), np.array(variance))
