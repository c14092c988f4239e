"""Where are devices likely to be that were given no track, and how well is that known?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["estimates"]

Array = NDArray[np.float64]

WORTH = 1e-3
"""Share of the likeliest cell's probability below which a cell does not count."""
LEAST_VARIANCE = 0.1
"""m², along each axis: no place is known better than that."""


def estimates(
    on: Array, places: Array, floor: Array, centres: Array, rest: Array, far: Array
) -> tuple[Array, Array, Array]:
    """Return mean places (d, 2), their covariances (d, 2, 2) and the probabilities (d,) of being about at all.

    Over tracks and floor together: of a device that may be on either of two tracks it is the place between.

    Args:
        on: (d, k), probability of each track.
        places: (k, 2), metres, where the tracks are.
        floor: (d, n), probability of each cell, in the proportions of those of "far".
        centres: (n, 2), metres, of the cells.
        rest: (d, 2), metres by which each device's floor is off the cells' centres.
        far: (d,), probability of being far away.
    """
    if not len(on):
        return np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0)
    about = floor.sum(axis=1)
    tracked = on.sum(axis=1)
    unseen = np.maximum(1.0 - tracked, 0.0)
    share = unseen / np.maximum(about + far, 1e-300)
    counting = np.where(floor > WORTH * floor.max(axis=1, keepdims=True), floor, 0.0)
    # Moments about the floor's middle, so that squares of large coordinates cancel nothing.
    middle = centres.mean(axis=0)
    cells = (counting @ _powers(centres - middle)) * share[:, None]
    mass, x, y = cells[:, 0], rest[:, 0], rest[:, 1]
    cells = cells + np.column_stack(
        [
            np.zeros(len(on)),
            mass * x,
            mass * y,
            2.0 * x * cells[:, 1] + mass * x * x,
            x * cells[:, 2] + y * cells[:, 1] + mass * x * y,
            2.0 * y * cells[:, 2] + mass * y * y,
        ]
    )
    moments = cells + on @ _powers(places - middle)
    moments /= np.maximum(moments[:, :1], 1e-300)
    mean = moments[:, 1:3]
    covariance = moments[:, [3, 4, 4, 5]].reshape(-1, 2, 2) - mean[:, :, None] * mean[:, None, :]
    covariance += LEAST_VARIANCE * np.eye(2)
    return mean + middle, covariance, np.minimum(tracked + share * about, 1.0)


def _powers(places: Array) -> Array:
    """Return 1, x, y, x², xy, y² of (n, 2) places as (n, 6)."""
    x, y = places.T
    return np.column_stack([np.ones(len(places)), x, y, x * x, x * y, y * y])
