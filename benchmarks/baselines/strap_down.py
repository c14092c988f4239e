"""Where does a phone get to by integrating its acceleration twice? [self-calibrating-rss-thesis §3.3].

Shown to fail: within a minute the speed has drifted beyond anything a walker could do.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["strap_down"]

Array = NDArray[np.float64]

GRAVITY = 9.81


def strap_down(acceleration: Array, attitude: Array, dt: float, velocity: Array) -> tuple[Array, Array]:
    """Return velocity and position, each (n, 2) east and north, m/s and m, from the origin.

    Args:
        acceleration: (n, 3) m/s², gravity included, phone axes.
        attitude: (n, 3, 3) rotations from the phone's axes to (east, north, up).
        dt: seconds between samples.
        velocity: (2,) m/s at the beginning.
    """
    linear = np.einsum("nij,nj->ni", attitude, acceleration) - [0.0, 0.0, GRAVITY]
    speed = velocity + np.cumsum(linear[:, :2], axis=0) * dt
    return speed, np.cumsum(speed, axis=0) * dt
