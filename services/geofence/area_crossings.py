"""Who is inside of which area: one two-state machine per track and area, all of them advanced at once.

Somebody outside enters once there is enough evidence (``evidence``) of a place inside, by a margin, and leaves
likewise: between the two borders noise speaks for staying. A track that touched an area and is surely outside again has
*passed* if the way from where it was last surely outside leads through: enter and exit at once, however thin the area
and however long the step. One that touched and went back where it came from has not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.geofence.evidence import gathered, lingering
from services.geofence.pairs import Frame, Pairs
from services.geofence.ways import lately_near

__all__ = ["AreaStep", "advance_areas"]

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


ENTER_MARGIN = 0.1
"""Of the margin: who walks in is told sooner than who walks out, whom nobody wants back a moment later."""
EXIT_PATIENCE = 1.5
"""Times the least seconds, likewise."""
WALKS_IN = 2.0
"""Seconds beside an area in which nobody lingers: so long takes who just walks in."""


@dataclass(frozen=True, slots=True)
class AreaStep:
    """What happened to (m,) pairs; each array is boolean, or lists places among the pairs."""

    enters: Ints
    exits: Ints
    passes: Ints
    """May have passed: whether they did, the way from ``anchor`` tells."""
    stays: Bools
    """Must be remembered."""


def advance_areas(state: NDArray[Any], new: Bools, pairs: Pairs, frame: Frame, min_seconds: float) -> AreaStep:
    """Advance (m,) pairs of tracks and areas to the frame, in place.

    Args:
        state: (m,) of ``PAIR``; what is ``new`` holds only its code.
        new: (m,) whether the pair mattered not so far: the track was surely outside, or is new itself.
        pairs: (m,).
        frame: in which they are.
        min_seconds: see ``evidence.gathered``.
    """
    row, t = pairs.row, frame.t
    x, y, known = frame.x[row], frame.y[row], frame.known[row]
    # Somebody seen first beside an area starts there; one seen first inside of it has not come through anything.
    state["side"][new] = -1
    state["anchor_t"][new] = np.where(known, frame.before_t[row], t)[new]
    state["anchor_x"][new] = np.where(known, frame.before_x[row], np.where(pairs.depth < 0.0, x, np.nan))[new]
    state["anchor_y"][new] = np.where(known, frame.before_y[row], y)[new]

    inside = state["side"] > 0
    outside = ~inside
    beyond = np.where(inside, -pairs.depth - pairs.margin, pairs.depth - ENTER_MARGIN * pairs.margin)
    demand = np.where(inside, 0.0, pairs.demand)
    before = state["evidence"]
    seconds = np.where(known, t - frame.before_t[row], 0.0)
    # Exactly known places have no spread: a hair keeps the division.
    patience = min_seconds * np.where(inside, EXIT_PATIENCE, lingering(t - state["anchor_t"] - WALKS_IN))
    evidence = gathered(before, beyond / np.maximum(pairs.sigma, 1e-9) - demand, seconds, patience)
    begins = (evidence > 0.0) & (before == 0.0)
    for name, value in (("t", np.full(len(row), t)), ("x", x), ("y", y)):
        state[name][begins] = value[begins]
    turns = evidence >= 1.0
    touched = state["touched"] | (pairs.depth >= 0.0) | pairs.crossed
    surely_out = pairs.depth < -pairs.sure
    # Whoever stands in a narrow area is measured on this side and on that: by one standard deviation, that is no news.
    out = (-pairs.depth - pairs.margin) / np.maximum(pairs.sigma, 1e-9) - 1.0
    away = np.where(touched, gathered(state["away"], out, seconds, EXIT_PATIENCE * min_seconds), 0.0)
    narrow = np.flatnonzero(outside & pairs.narrow)
    if len(narrow):
        place = np.column_stack([x[narrow], y[narrow]])
        lately_near(state, narrow, pairs.depth[narrow], pairs.sigma[narrow], place, seconds[narrow])
    # One position that jumps away ends nothing that was begun.
    ends = outside & ~turns & surely_out & (~touched | (away >= 1.0))
    passes = np.flatnonzero(ends & touched & np.isfinite(state["anchor_x"]))
    enters, exits = np.flatnonzero(turns & outside), np.flatnonzero(turns & inside)
    state["evidence"] = np.where(turns, 0.0, evidence)
    state["side"][turns] = -state["side"][turns]
    state["touched"], state["away"] = touched, away
    # Whoever left was last outside here.
    state["touched"][exits], state["away"][exits] = False, 0.0
    for name in ("near", "near_x", "near_y"):
        state[name][exits] = 0.0
    state["anchor_t"][exits], state["anchor_x"][exits], state["anchor_y"][exits] = t, x[exits], y[exits]
    return AreaStep(enters, exits, passes, (state["side"] > 0) | ~ends & (state["touched"] | ~surely_out))
