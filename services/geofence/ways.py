"""Which way did somebody take past a border? From where they were last surely on this side, by the mean of the
positions lately near it, to where they are surely on the other: one position alone may be wrong by its whole spread.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["lately_near", "ways_of"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_LATELY = 1.0
"""Seconds after which a position weighs less by e: who walks along a border for long crosses it at the end."""
_ENOUGH = 2.0
"""Positions by their weights, from which on their mean says better than the straight way where the border was."""
_WRONG = 0.7
"""Standard deviations of a position by which that mean may be wrong."""
_AROUND = np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])


def lately_near(state: NDArray[Any], some: Ints, depth: Floats, sigma: Floats, place: Floats, seconds: Floats) -> None:
    """Add positions to the mean of those near a border, in place.

    Args:
        state: (m,) of ``PAIR``.
        some: (k,) of them.
        depth: (k,) metres.
        sigma: (k,) metres, standard deviation of the depth.
        place: (k, 2) metres.
        seconds: (k,) since the position before.
    """
    weight = np.exp(-0.5 * (depth / np.maximum(sigma, 1e-9)) ** 2)
    kept = np.exp(-seconds / _LATELY)
    for name, value in (("near", weight), ("near_x", weight * place[:, 0]), ("near_y", weight * place[:, 1])):
        state[name][some] = kept * state[name][some] + value


def ways_of(pair: Any, here: Floats, spread: float, aside: float) -> Floats:
    """Return the (w, k, 2) ways that a pair's track may have taken from its anchor to ``here``, likeliest first.

    ``spread``: standard deviation of a position, metres; where few positions were near, the straight way is shifted by
    ``aside`` of these.
    """
    start = np.array([pair["anchor_x"], pair["anchor_y"]])
    if pair["near"] >= _ENOUGH:
        middle = np.array([pair["near_x"], pair["near_y"]]) / float(pair["near"])
        return np.array([[start, middle + shift, here] for shift in _WRONG * spread * _AROUND])
    along = here - start
    length = float(np.hypot(*along))
    shift = np.array([-along[1], along[0]]) * (aside * spread / length if length > 0.0 else 0.0)
    return np.array([[start, here], [start + shift, here + shift], [start - shift, here - shift]])
