"""Which person does each track follow at one time, and when was each person in view? What scores of names rest on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from shared.messages import TrackFrame, positions

__all__ = ["NOBODY", "people_followed", "stays"]

Array = NDArray[np.float64]

NOBODY = -1
"""A track follows no person."""
PAUSE = 2.0
"""Seconds; somebody out of view for no longer has not left."""


def people_followed(frame: TrackFrame, place: Array, gate: float) -> NDArray[np.int64]:
    """Return (tracks,) whom each track of a frame follows: a row of ``place``, or ``NOBODY``.

    Tracks and people are matched one to one: most pairs within the gate, then the shortest.

    Args:
        frame: what was said.
        place: (p, 2) metres, of everybody; NaN for who is not there.
        gate: metres.
    """
    people = np.flatnonzero(np.isfinite(place).all(axis=1))
    apart: Array = np.linalg.norm(positions(frame)[:, None] - place[people][None], axis=2)
    # A pair outside the gate costs more than all pairs inside it together.
    tracks, matched = linear_sum_assignment(np.where(apart <= gate, apart, 1e3 * gate * (1 + len(people))))
    inside = apart[tracks, matched] <= gate
    whom = np.full(len(frame.track), NOBODY, np.int64)
    whom[tracks[inside]] = people[matched[inside]]
    return whom


def stays(t: Array, in_view: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the first and last place of each time in view, pauses of up to ``PAUSE`` seconds bridged."""
    seen = np.flatnonzero(in_view)
    parted = np.flatnonzero((np.diff(t[seen]) > PAUSE) & (np.diff(seen) > 1)) + 1
    return [(int(piece[0]), int(piece[-1])) for piece in np.split(seen, parted) if len(piece)]
