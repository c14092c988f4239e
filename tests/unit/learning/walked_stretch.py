"""Stretches of somebody who walks through a camera's view, for tests of what learns from walking."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.learning.tracks.stretch import Stretch

__all__ = ["walked"]

Array = NDArray[np.float64]


def walked(
    rng: np.random.Generator,
    start: float = 0.0,
    *,
    device: str = "phone",
    length: float = 0.6,
    cadence: float = 1.8,
    published: float = 0.7,
    turned: float = 0.0,
    walk: int = 1,
    seconds: float = 20.0,
    noise: float = 0.02,
    irregular: float = 0.03,
) -> Stretch:
    """Return one walk at a constant pace; positions err slowly, as those of a track do."""
    t = start + np.arange(0.0, seconds, 0.2)
    direction = rng.uniform(-np.pi, np.pi)
    unit = np.array([np.cos(direction), np.sin(direction)])
    slow = np.cumsum(rng.normal(0.0, noise, (len(t), 2)), axis=0) * 0.5
    step_t = np.arange(start + 0.3, start + seconds, 1.0 / cadence)
    step_t = step_t + rng.normal(0.0, 0.01, len(step_t))
    way = (t - start) * cadence * length * (1.0 + irregular * rng.normal())
    n, s = len(t), len(step_t)
    empty = np.empty(0)
    return Stretch(
        device=device,
        track=1,
        t=t,
        place=way[:, None] * unit + slow,
        covariance=np.tile(0.03 * np.eye(2), (n, 1, 1)),
        probability=np.full(n, 0.95),
        seen=np.ones(n, np.bool_),
        sight=np.full(n, 2.0),
        scan_t=empty,
        point=np.empty(0, np.int64),
        level=empty,
        scan_place=np.empty((0, 2)),
        scan_spread=empty,
        step_t=step_t,
        length=np.full(s, published),
        length_variance=np.full(s, 0.05),
        heading=np.full(s, direction + turned) + rng.normal(0.0, 0.2, s),
        heading_variance=np.full(s, 0.3),
        walk=np.full(s, walk, np.int64),
    )
