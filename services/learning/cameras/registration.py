"""Two cameras look at one floor: which correction brings what one of them sees onto what the other sees?

Nobody says who is who, and a knocked camera sees people a metre or two from where they are, among others. So nobody is
paired beforehand: all that are in reach of each other vote for a shift, at each turn, and only the right one gets a
vote from every true pair. Then pairs that chose each other refine it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

__all__ = ["REACH", "Snapshot", "explained", "moved", "register", "turn_of"]

Array = NDArray[np.float64]

FAR = 1e6
REACH = 3.5
"""Metres; who is further apart is no pair."""
TURNS: Array = np.radians(np.arange(-14.0, 14.1, 2.0))
PANS: Array = np.radians(np.arange(-12.0, 12.1, 2.0))
TILTS: Array = np.radians(np.arange(-5.0, 5.1, 1.0))
"""About the vertical, and about either axis of the plan."""
TURN_SIGMA = math.radians(10.0)
VOTE_REACH = 0.6
"""Metres."""
BIN = 0.3
"""Metres of a vote."""
MOST_VOTES = 4000
"""Pairs that vote."""
GATES = (1.0, 0.7, 0.5, 0.5, 0.5)
"""Metres within which pairs refine, round after round."""
SIGMA = 0.25
"""Metres by which two cameras that are right differ about one person."""
STRANGER = 0.3
"""Share of detections the other camera has nothing of."""
LEAST_PAIRS = 30
LEAST_SPREAD = 0.7
"""Metres of standard deviation of the pairs' places, below which a turn or a stretch cannot be told from a shift."""
BELIEF = 40.0
"""Pairs' worth of belief that a knock neither stretches the plan nor turns it."""


@dataclass(frozen=True)
class Snapshot:
    """What two cameras saw at one time.

    Attributes:
        t: seconds since the epoch.
        ours: (n, 2) metres, of the camera in question.
        theirs: (m, 2) metres, of another one.
    """

    t: float
    ours: Array
    theirs: Array


def register(snapshots: Sequence[Snapshot], hangs: Array | None = None) -> Array | None:
    """Return the homography (3, 3) from ``ours`` to ``theirs``; None where too few pairs say anything.

    Args:
        snapshots: what both saw.
        hangs: (3,) metres, where our camera hangs; with it, its turns about that place are tried beside similarities.
    """
    even = _register_similarity(snapshots)
    turned = None if hangs is None else _register_turn(snapshots, hangs)
    if even is None or turned is None:
        return turned if even is None else even
    return max((even, turned), key=lambda found: float(explained(snapshots, found).mean()))


def turn_of(rotation: Array, hangs: Array) -> Array:
    """Return what a camera's turn about the place (3,) it hangs at does to the plan: a homography (3, 3).

    Whatever its lens is: a ray to the floor is turned, and meets the floor elsewhere.

    Args:
        rotation: (3,) radians about x, y and z of the plan, small.
        hangs: (3,) metres.
    """
    ray = np.array([[1.0, 0.0, -hangs[0]], [0.0, 1.0, -hangs[1]], [0.0, 0.0, -hangs[2]]])
    matrix = np.linalg.solve(ray, Rotation.from_rotvec(rotation).as_matrix() @ ray)
    found: Array = matrix / matrix[2, 2]
    return found


def _register_turn(snapshots: Sequence[Snapshot], hangs: Array) -> Array | None:
    candidates = [_candidates(snapshot) for snapshot in snapshots]
    x, y = (np.concatenate([pair[side] for pair in candidates] or [np.empty((0, 2))]) for side in (0, 1))
    if len(x) < LEAST_PAIRS:
        return None
    every = -(-len(x) // MOST_VOTES)
    x, y = x[::every], y[::every]
    grid = np.stack(np.meshgrid(TILTS, TILTS, PANS, indexing="ij"), axis=-1).reshape(-1, 3)
    votes = [_near(x, y, turn_of(rotation, hangs)) for rotation in grid]
    rotation = grid[int(np.argmax(votes))]
    for gate in (*GATES[:1] * 3, *GATES):
        found = turn_of(rotation, hangs)
        chosen = [_mutual(moved(found, snapshot.ours), snapshot, gate) for snapshot in snapshots]
        x, y = (np.concatenate([pair[side] for pair in chosen]) for side in (0, 1))
        if len(x) < LEAST_PAIRS:
            return None
        off = y - moved(found, x)
        weight = 1.0 / (1.0 + (off**2).sum(axis=1) / SIGMA**2)
        slope = np.stack([moved(turn_of(rotation + d, hangs), x) - moved(found, x) for d in 1e-5 * np.eye(3)]) / 1e-5
        information = np.einsum("ank,n,bnk->ab", slope, weight, slope) + np.eye(3) / TURN_SIGMA**2 * SIGMA**2
        rotation = rotation + np.linalg.solve(information, np.einsum("ank,n,nk->a", slope, weight, off))
    return turn_of(rotation, hangs)


def _near(x: Array, y: Array, homography: Array) -> int:
    """Return how many of the pairs (n, 2) come together; nobody beyond the horizon does."""
    scale = x @ homography[2, :2] + homography[2, 2]
    mapped = x @ homography[:2, :2].T + homography[:2, 2]
    off = mapped - y * scale[:, None]
    return int(((scale > 0.1) & ((off**2).sum(axis=1) < (VOTE_REACH * scale) ** 2)).sum())


def _register_similarity(snapshots: Sequence[Snapshot]) -> Array | None:
    candidates = [_candidates(snapshot) for snapshot in snapshots]
    ours, theirs = (np.concatenate([pair[side] for pair in candidates] or [np.empty((0, 2))]) for side in (0, 1))
    if len(ours) < LEAST_PAIRS:
        return None
    centre = ours.mean(axis=0)
    every = -(-len(ours) // MOST_VOTES)
    ours, theirs = ours[::every], theirs[::every]
    best = max((_vote(ours - centre, theirs - centre, turn) for turn in TURNS), key=lambda vote: vote[0])
    found = _similarity(best[1], 1.0, best[2], centre)
    for gate in GATES:
        chosen = [_mutual(moved(found, snapshot.ours), snapshot, gate) for snapshot in snapshots]
        x, y = (np.concatenate([pair[side] for pair in chosen]) for side in (0, 1))
        if len(x) < LEAST_PAIRS:
            return None
        found = _fit(x, y, moved(found, x))
    return found


def explained(snapshots: Sequence[Snapshot], homography: Array) -> Array:
    """Return how well each snapshot's ``theirs`` explain its ``ours`` after a correction: (k,) nats a detection.

    Only detections with somebody in reach without a correction count, the same whatever the correction is.
    """
    nats = np.zeros(len(snapshots))
    for row, snapshot in enumerate(snapshots):
        apart = _apart(moved(homography, snapshot.ours), snapshot.theirs)
        nearest = apart.min(axis=1)
        seen = (1.0 - STRANGER) / (2.0 * math.pi * SIGMA**2) * np.exp(-0.5 * (nearest / SIGMA) ** 2)
        nats[row] = float(np.mean(np.log(seen + STRANGER / (math.pi * REACH**2))))
    return nats


def moved(homography: Array, places: Array) -> Array:
    """Return places (n, 2) after a homography (3, 3) of the plan; what comes beyond the horizon is far away."""
    mapped = places @ homography[:2, :2].T + homography[:2, 2]
    scale = places @ homography[2, :2] + homography[2, 2]
    there: Array = np.where(scale[:, None] > 1e-3, mapped / np.maximum(scale, 1e-3)[:, None], FAR)
    return there


def _candidates(snapshot: Snapshot) -> tuple[Array, Array]:
    ours, theirs = np.nonzero(_apart(snapshot.ours, snapshot.theirs) < REACH)
    return snapshot.ours[ours], snapshot.theirs[theirs]


def _vote(ours: Array, theirs: Array, turn: float) -> tuple[float, float, Array]:
    """Return the most votes a shift gets, the turn, and that shift (2,)."""
    cos, sin = math.cos(turn), math.sin(turn)
    shift = theirs - ours @ np.array([[cos, sin], [-sin, cos]])
    size = int(2.0 * (REACH + 1.0) / BIN)
    bins = np.floor(shift / BIN).astype(np.int64) + size // 2
    inside = np.all((bins >= 1) & (bins < size - 1), axis=1)
    votes = np.bincount(bins[inside, 0] * size + bins[inside, 1], minlength=size * size).reshape(size, size)
    around = np.zeros((size, size))
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            around += np.roll(votes, (i, j), axis=(0, 1))
    row, column = np.unravel_index(int(np.argmax(around)), around.shape)
    return float(around[row, column]), turn, (np.array([row, column]) - size // 2 + 0.5) * BIN


def _mutual(there: Array, snapshot: Snapshot, gate: float) -> tuple[Array, Array]:
    """Return those of ``ours``, and of ``theirs``, that are each other's nearest after a correction."""
    apart = _apart(there, snapshot.theirs)
    nearest = apart.argmin(axis=1)
    rows = np.arange(len(there))
    chosen = (apart.argmin(axis=0)[nearest] == rows) & (apart[rows, nearest] < gate)
    return snapshot.ours[chosen], snapshot.theirs[nearest[chosen]]


def _fit(x: Array, y: Array, now: Array) -> Array:
    """Return the similarity from x to y (n, 2), robust about what is found ``now``, stretching reluctantly."""
    off = np.linalg.norm(y - now, axis=1)
    weight = 1.0 / (1.0 + (off / SIGMA) ** 2)
    total = float(weight.sum())
    centre, target = weight @ x / total, weight @ y / total
    a, b = x - centre, y - target
    spread = float(weight @ (a**2).sum(axis=1))
    along = float(weight @ (a * b).sum(axis=1))
    across = float(weight @ (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    believed = BELIEF * LEAST_SPREAD**2
    turn = math.atan2(across, along + believed)
    scale = (math.hypot(along, across) + believed) / (spread + believed)
    return _similarity(turn, scale, target - centre, centre)


def _similarity(turn: float, scale: float, shift: Array, centre: Array) -> Array:
    """Return the similarity (3, 3) that turns and stretches about ``centre`` and then shifts."""
    linear = scale * np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    matrix = np.eye(3)
    matrix[:2, :2] = linear
    matrix[:2, 2] = centre + shift - linear @ centre
    return matrix


def _apart(x: Array, y: Array) -> Array:
    apart: Array = np.linalg.norm(x[:, None] - y[None], axis=2)
    return apart
