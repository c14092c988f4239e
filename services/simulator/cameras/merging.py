"""Whom does a detector take for one? People whose bodies lie over each other in the picture become one blob."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["leaders", "near_pairs"]

Array = NDArray[np.float64]
Ints = NDArray[np.intp]
Bools = NDArray[np.bool_]


def near_pairs(box: Array, active: Bools) -> tuple[Ints, Ints, Ints]:
    """Return frames, first and second columns (m,) of the pairs whose boxes (n, c, 4) touch in the picture."""
    first, second = np.triu_indices(box.shape[1], 1)
    # Who never comes near another in the whole block need not be asked about in each frame.
    low = np.where(active[..., None], box[..., :2], np.inf).min(axis=0, initial=np.inf)
    high = np.where(active[..., None], box[..., 2:], -np.inf).max(axis=0, initial=-np.inf)
    meet = (low[first] < high[second]).all(axis=1) & (low[second] < high[first]).all(axis=1)
    first, second = first[meet], second[meet]
    with np.errstate(invalid="ignore"):
        touch = active[:, first] & active[:, second]
        for lower, upper in ((0, 2), (1, 3)):
            touch &= box[:, first, lower] < box[:, second, upper]
            touch &= box[:, second, lower] < box[:, first, upper]
    frame, pair = np.nonzero(touch)
    return frame, first[pair], second[pair]


def leaders(
    count: tuple[int, int], frame: Ints, one: Ints, other: Ints, closeness: Array, distance: Array
) -> tuple[Ints, Ints, Ints]:
    """Return frames, absorbed and absorbing columns (m,): a body is lost in the nearest nearer one it is linked to.

    Who is lost absorbs nobody, so that a row of people becomes several blobs, as a detector that knows how large a
    person is would have it.

    Args:
        count: frames and columns.
        frame: (k,) of the links.
        one: (k,) columns.
        other: (k,) columns.
        closeness: (k,) the larger, the closer.
        distance: (n, c) of the bodies from the camera.
    """
    one_nearer = distance[frame, one] <= distance[frame, other]
    near, far = np.where(one_nearer, one, other), np.where(one_nearer, other, one)
    # Of every lost candidate only its closest nearer partner counts: the last written wins.
    order = np.argsort(closeness, kind="stable")
    partner = np.full(count, -1, np.intp)
    partner[frame[order], far[order]] = near[order]
    row, column = np.nonzero(partner >= 0)
    nearest = partner[row, column]
    lost = np.zeros(count, bool)
    for _ in range(_LONGEST_ROW):
        # Lost is whose partner is not; partners are nearer, so each round settles the next body of a row.
        lost[row, column] = ~lost[row, nearest]
    keep = lost[row, column] & ~lost[row, nearest]
    return row[keep], column[keep], nearest[keep]


_LONGEST_ROW = 8
"""Bodies one behind the other that are told apart; of what lies deeper in a crowd some stand for themselves."""
