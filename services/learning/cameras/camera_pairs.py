"""Do two cameras contradict each other? What both saw of the same floor at the same times, and what that says."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.learning.cameras.registration import REACH, Snapshot, explained, moved, register

__all__ = ["LEAST", "LOOK_EVERY", "CameraPairs", "Pair", "gain_of"]

Array = NDArray[np.float64]

EVERY = 1.0
"""Seconds between two snapshots of a pair."""
TOGETHER = 0.1
"""Seconds by which the frames of a snapshot may be apart."""
KEPT = 900.0
"""Seconds of snapshots."""
RECENT = 30
"""Snapshots a pair is judged by …"""
LEAST = 15
"""… and the least of them."""
LOOK_EVERY = 30.0
"""Seconds between two looks at a pair."""
OFF = 0.35
"""Metres two cameras may contradict each other: feet are seen two tenths nearer or further from another side."""
LEAST_GAIN = 0.1
"""Nats per detection; more than the two tenths are worth."""
SURE = 3.0
"""Standard errors."""
BLOCK = 5
"""Snapshots in a row whose gains are alike."""


@dataclass(frozen=True)
class Pair:
    """What two cameras say of each other: whether they contradict, by how many metres, since when."""

    off: bool
    offset: float
    since: float


class CameraPairs:
    """The cameras of an area, two by two."""

    def __init__(self) -> None:
        self._newest: dict[str, tuple[float, Array]] = {}
        self._snapshots: dict[tuple[str, str], deque[Snapshot]] = {}
        self._judged: dict[tuple[str, str], tuple[float, Pair]] = {}

    @property
    def cameras(self) -> list[str]:
        """Of which something was heard."""
        return sorted(self._newest)

    def take(self, camera: str, t: float, places: Array) -> None:
        """Take in where a camera saw people, (n, 2) metres, in order of time."""
        self._newest[camera] = (t, places)
        for other, (before, theirs) in self._newest.items():
            if other == camera or abs(t - before) > TOGETHER:
                continue
            key = _key(camera, other)
            kept = self._snapshots.setdefault(key, deque())
            if kept and t < kept[-1].t - KEPT:
                kept.clear()
                self._judged.pop(key, None)
            if kept and t < kept[-1].t + EVERY:
                continue
            ours, of_second = (places, theirs) if camera == key[0] else (theirs, places)
            near = np.linalg.norm(ours[:, None] - of_second[None], axis=2) < REACH
            if near.any():
                kept.append(Snapshot(t, ours[near.any(axis=1)], of_second[near.any(axis=0)]))
            while kept and kept[0].t < t - KEPT:
                kept.popleft()

    def forget(self, camera: str) -> None:
        """Forget what was seen together with a camera: from now on it sees otherwise."""
        for key in [key for key in self._snapshots if camera in key]:
            del self._snapshots[key]
            self._judged.pop(key, None)

    def of(self, camera: str, other: str) -> list[Snapshot]:
        """Return the snapshots of two cameras in order of time, ``ours`` being the first one's."""
        kept = self._snapshots.get(_key(camera, other), ())
        if camera < other:
            return list(kept)
        return [Snapshot(one.t, one.theirs, one.ours) for one in kept]

    def newest(self, camera: str, other: str) -> float:
        """Return the time of their newest snapshot; minus infinity where there is none."""
        kept = self._snapshots.get(_key(camera, other))
        return kept[-1].t if kept else -math.inf

    def said(self, one: str, other: str) -> Pair | None:
        """Return what two cameras say of each other now; None where too little was seen by both."""
        key = _key(one, other)
        snapshots = self._snapshots.get(key)
        if not snapshots:
            return None
        newest = snapshots[-1].t
        judged = self._judged.get(key)
        if judged is None or newest >= judged[0] + LOOK_EVERY:
            pair = _judge(list(snapshots))
            if pair is None:
                return None
            judged = self._judged[key] = (newest, pair)
        return judged[1]


def gain_of(snapshots: Sequence[Snapshot], homography: Array) -> tuple[float, float]:
    """Return the gain of a correction over none, nats per detection, and what it must exceed."""
    nats = explained(snapshots, homography) - explained(snapshots, np.eye(3))
    blocks = np.array([block.mean() for block in np.array_split(nats, max(2, len(nats) // BLOCK))])
    return float(nats.mean()), max(LEAST_GAIN, SURE * float(blocks.std(ddof=1)) / math.sqrt(len(blocks)))


def _judge(snapshots: Sequence[Snapshot]) -> Pair | None:
    recent = snapshots[-RECENT:]
    found = register(recent) if len(recent) >= LEAST else None
    if found is None:
        return None
    places = np.concatenate([one.ours for one in recent])
    offset = float(np.median(np.linalg.norm(moved(found, places) - places, axis=1)))
    mean, margin = gain_of(recent, found)
    if offset < OFF or mean < margin:
        return Pair(False, offset, math.inf)
    # It began where, from there on, the correction was the better of the two (a cumulative sum).
    better = np.cumsum(explained(snapshots, found) - explained(snapshots, np.eye(3)))
    since = snapshots[min(int(np.argmin(better)) + 1, len(snapshots) - 1)].t if better.min() < 0.0 else snapshots[0].t
    return Pair(True, offset, since)


def _key(one: str, other: str) -> tuple[str, str]:
    return (one, other) if one < other else (other, one)
