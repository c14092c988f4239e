"""Who crossed which directed line: the side on which somebody surely is, and the steps that cut the line in between.

A crossing counts once somebody is surely on the other side (``evidence``) and the steps since they were surely on this
one cut the line once more in that direction than back. Whoever goes round its end cuts it not; whoever steps over it
and back is on the same side again; noise on the line cuts it back and forth.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.geofence.evidence import gathered, lingering
from services.geofence.pairs import Frame, Pairs
from services.geofence.ways import lately_near

__all__ = ["advance_lines"]

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

MARGIN = 0.4
"""Of the margin, on either side: there is no inside that noise should not flicker out of."""
PATIENCE = 1.5
"""Times the least seconds: a crossing is told with its own time, and nobody stands on a line to be counted twice."""


def advance_lines(
    state: NDArray[Any], new: Bools, pairs: Pairs, frame: Frame, min_seconds: float, depth_before: Floats
) -> tuple[Ints, Ints, Ints, Bools]:
    """Advance (m,) pairs of tracks and lines to the frame, in place.

    Args:
        state: (m,) of ``PAIR``; what is ``new`` holds only its code.
        new: (m,) whether the pair mattered not so far.
        pairs: (m,).
        frame: in which they are.
        min_seconds: see ``evidence.gathered``.
        depth_before: (m,) metres left of the line in the frame before, where new; NaN where nobody knows surely.

    Returns:
        forward: places among the pairs that crossed from left to right.
        backward: and from right to left.
        doubtful: on the other side by steps that seem to go round the line; near its ends the way from ``anchor``,
            where the track was last surely on this side, tells it better.
        stays: (m,) whether the pair must be remembered.
    """
    row = pairs.row
    # Who is seen first beside a line, or is new there, is on no side yet.
    state["side"][new] = np.where(np.isfinite(depth_before), np.where(depth_before >= 0.0, 1, -1), 0)[new]
    known = frame.known[row]
    state["anchor_t"][new] = np.where(known, frame.before_t[row], frame.t)[new]
    state["anchor_x"][new] = np.where(known, frame.before_x[row], frame.x[row])[new]
    state["anchor_y"][new] = np.where(known, frame.before_y[row], frame.y[row])[new]
    cut = pairs.crossed
    share = pairs.share
    before_t, before_x, before_y = frame.before_t[row], frame.before_x[row], frame.before_y[row]
    state["net"] += pairs.net
    state["t"][cut] = (before_t + share * (frame.t - before_t))[cut]
    state["x"][cut] = (before_x + share * (frame.x[row] - before_x))[cut]
    state["y"][cut] = (before_y + share * (frame.y[row] - before_y))[cut]

    patience = PATIENCE * min_seconds * lingering(frame.t - state["anchor_t"])
    side = state["side"].astype(float)
    seconds = np.where(frame.known[row], frame.t - before_t, 0.0)
    margin = MARGIN * pairs.margin
    beyond = np.where(side == 0.0, pairs.depth, -side * pairs.depth) - margin
    sigma = np.maximum(pairs.sigma, 1e-9)
    place = np.column_stack([frame.x[row], frame.y[row]])
    lately_near(state, np.arange(len(row)), pairs.depth, sigma, place, seconds)
    state["evidence"] = gathered(state["evidence"], beyond / sigma - pairs.demand, seconds, patience)
    turns = state["evidence"] >= 1.0
    told = turns & (state["net"] * side > 0.0)
    forward, backward = np.flatnonzero(told & (side > 0.0)), np.flatnonzero(told & (side < 0.0))
    nowhere = side == 0.0
    doubtful = np.flatnonzero(turns & ~told & ~nowhere)
    right = (-pairs.depth - margin) / sigma - pairs.demand
    state["away"] = np.where(nowhere, gathered(state["away"], right, seconds, patience), 0.0)
    state["side"] = np.where(turns, np.where(nowhere, 1, -side), np.where(state["away"] >= 1.0, -1, side))
    settled = turns | (nowhere & (state["side"] != 0))
    state["net"][settled] = 0
    state["evidence"][settled] = 0.0
    surely_here = state["side"] * pairs.depth > pairs.sure
    return forward, backward, doubtful, ~surely_here | settled
