"""Do the people a camera sees stand where people can stand? The plan of the floor says where a knocked camera is wrong.

A camera that is right puts hardly anybody into showcases and pillars or off the floor; one that was knocked by a metre
puts a twentieth of the people or more there, at once. That needs no second camera and no phone.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.messages import DetectionFrame

__all__ = ["BlockedPlaces", "Impossible", "Walkable"]

Array = NDArray[np.float64]
Walkable = Callable[[Array], NDArray[np.bool_]]

EVERY = 0.5
"""Seconds between two frames that count: whoever stands there a moment later is the same person."""
BLOCK = 10.0
"""Seconds in which detections are thought alike."""
RECENT = (6, 18)
"""Blocks held against the ones before: a minute shows a plain case, three what is less so."""
LEAST_BEFORE = 12
"""Blocks from which it is known what is usual; with fewer, ``AT_ONCE`` decides."""
LEAST_SEEN = 20
"""Detections in the recent blocks."""
KEPT = 360
"""Blocks: an hour."""
MORE, TIMES = 0.02, 3.0
"""The share must be so much, and so many times, larger than usual."""
AT_ONCE = 0.08
"""Share that is wrong whatever is usual."""
SURE = 3.0
"""Standard errors, by what blocks differ."""


@dataclass(frozen=True)
class Impossible:
    """How many of the people a camera sees stand where nobody can.

    Attributes:
        share: lately.
        usual: before; None where it was always so.
        since: seconds since the epoch, when it began.
    """

    share: float
    usual: float | None
    since: float


class BlockedPlaces:
    """Counts an area's detections in impossible places.

    Args:
        walkable: whether a person can stand at each of (n, 2) places, such as ``FloorPlan.walkable``.
    """

    def __init__(self, walkable: Walkable) -> None:
        self._walkable = walkable
        self._blocks: dict[str, deque[list[float]]] = {}
        """By camera: beginning of a block, detections, and how many of them in impossible places."""
        self._last: dict[str, float] = {}

    def take_frame(self, frame: DetectionFrame) -> None:
        """Take in what a camera saw, in order of time."""
        last = self._last.get(frame.camera, -math.inf)
        if last - 60.0 < frame.t < last + EVERY:
            return
        self._last[frame.camera] = frame.t
        blocks = self._blocks.setdefault(frame.camera, deque(maxlen=KEPT))
        if blocks and frame.t < blocks[-1][0] - 60.0:
            blocks.clear()  # the clock was set back
        if not blocks or frame.t >= blocks[-1][0] + BLOCK:
            blocks.append([frame.t, 0.0, 0.0])
        if frame.x:
            places = np.column_stack([frame.x, frame.y])
            blocks[-1][1] += len(places)
            blocks[-1][2] += float((~self._walkable(places)).sum())

    def restart(self, camera: str) -> None:
        """Begin anew: the camera's positions have been corrected."""
        self._blocks.pop(camera, None)

    def reading(self, camera: str) -> Impossible | None:
        """Return what is wrong with a camera's positions lately; None where nothing is."""
        table = np.array([block for block in self._blocks.get(camera, ()) if block[1] > 0.0]).reshape(-1, 3)
        found = (_judge(table, recent) for recent in RECENT)
        return next((impossible for impossible in found if impossible is not None), None)


def _judge(table: Array, recent: int) -> Impossible | None:
    """Return what the last blocks of (k, 3) say, held against the ones before."""
    if len(table) < recent or table[-recent:, 1].sum() < LEAST_SEEN:
        return None
    t, seen, blocked = table.T
    shares = blocked / seen
    share = float(blocked[-recent:].sum() / seen[-recent:].sum())
    sure = share - SURE * float(shares[-recent:].std(ddof=1)) / math.sqrt(recent)
    if len(table) < LEAST_BEFORE + recent:
        return Impossible(share, None, float(t[0])) if sure > AT_ONCE else None
    # It began where, from there on, shares were more like this one than like nought: an hour with a knock in it is
    # judged by the time before.
    excess = np.cumsum(seen * (shares - 0.5 * share))
    begin = min(int(np.argmin(np.concatenate([[0.0], excess]))), len(shares) - recent)
    begin = max(begin, LEAST_BEFORE)
    usual = float(blocked[:begin].sum() / seen[:begin].sum())
    return Impossible(share, usual, float(t[begin])) if sure >= max(usual + MORE, TIMES * usual) else None
