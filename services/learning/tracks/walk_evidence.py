"""How well do a phone's steps fit each of several paths? Nats, against what people's paths are like anyway.

Second by second, how far and which way the path went is held against the steps of that second, and against standing
where the phone said it stood. All headings may be turned by one angle, which is marginalised: a phone lies askew in
its pocket. No second says more than ``LIMIT`` against a path, because tracks jump and steps are misread.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Walked", "walk_fit", "walked_of"]

Array = NDArray[np.float64]

PLACE_ERROR = 0.25
"""Metres, per axis, by which a track's way over a second is off."""
STRIDE_ERROR = 0.25
"""Share by which a second's steps are off, in length and across."""
SPEED = 0.8
"""Metres per second and axis that people who walk go."""
STANDING = 0.5
"""Share of the time that people stand."""
LIMIT = 3.0
"""Nats."""
TRUST = 0.5
"""Share of the nats that is believed: what goes wrong with steps goes wrong for seconds."""
ANGLES = 24
LEAST_TURN, MOST_TURN = 0.2, 2.0
"""Radians, of the standard deviation of the angle by which all headings are turned."""
COVERED = 0.6
"""Of a second that the phone must have said it stood for it to count."""


@dataclass(frozen=True)
class Walked:
    """What a phone said of each of n seconds.

    Attributes:
        way: (n,) complex, metres.
        known: (n,) whether it said anything.
        turn: radians, standard deviation of the angle by which all of it may be turned.
    """

    way: NDArray[np.complex128]
    known: NDArray[np.bool_]
    turn: float


def walked_of(t: Array, step_t: Array, length: Array, heading: Array, heading_variance: Array, still: Array) -> Walked:
    """Return what a phone said of the seconds between (n + 1,) times.

    Args:
        t: when the seconds begin, and the last one ends.
        step_t: (s,) when each step ended.
        length: (s,) metres.
        heading: (s,) radians.
        heading_variance: (s,) rad².
        still: (b, 2) begin and end of the times at which it said it stood.
    """
    seconds = len(t) - 1
    number = np.searchsorted(t, step_t, side="right") - 1
    inside = (number >= 0) & (number < seconds)
    steps = length[inside] * np.exp(1j * heading[inside])
    way = np.zeros(seconds, np.complex128)
    np.add.at(way, number[inside], steps)
    taken = np.bincount(number[inside], minlength=seconds) > 0
    stood = np.zeros(seconds)
    if len(still):
        overlap = np.minimum(still[:, 1, None], t[1:]) - np.maximum(still[:, 0, None], t[:-1])
        stood = np.maximum(overlap, 0.0).sum(axis=0) / np.diff(t)
    turn = math.sqrt(float(np.median(heading_variance))) if len(heading_variance) else MOST_TURN
    return Walked(way, taken | (stood >= COVERED), min(max(turn, LEAST_TURN), MOST_TURN))


def walk_fit(walked: Walked, paths: Array) -> Array:
    """Return the gain (k,) of k paths, (k, n + 1, 2) metres at the borders of the seconds."""
    if not walked.known.any():
        return np.zeros(len(paths))
    moved = np.diff(paths, axis=1)[:, walked.known]
    path = moved[..., 0] + 1j * moved[..., 1]
    way = walked.way[walked.known]
    variance = PLACE_ERROR**2 + (STRIDE_ERROR * np.abs(way)) ** 2
    went = np.abs(path) ** 2
    anybody = np.logaddexp(
        math.log(STANDING / PLACE_ERROR**2) - 0.5 * went / PLACE_ERROR**2,
        math.log((1.0 - STANDING) / (SPEED**2 + PLACE_ERROR**2)) - 0.5 * went / (SPEED**2 + PLACE_ERROR**2),
    )
    angles = 2.0 * math.pi / ANGLES * np.arange(ANGLES)
    before = np.cos(angles) / walked.turn**2
    before -= np.log(np.exp(before - before.max()).sum()) + before.max()
    aligned = path[:, None, :] * np.conj(way) * np.exp(-1j * angles)[:, None]
    away = went[:, None] + np.abs(way) ** 2 - 2.0 * aligned.real
    each = -0.5 * away / variance - np.log(variance) - anybody[:, None]
    total = TRUST * np.maximum(each, -LIMIT).sum(axis=2) + before
    most = total.max(axis=1)
    gain: Array = most + np.log(np.exp(total - most[:, None]).sum(axis=1))
    return gain
