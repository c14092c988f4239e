"""How well does a phone's walk suit each person that cameras follow? Stretch by stretch, once the phone has told it.

Steps come seconds late, and a walk only when it is sure to be one; where a sighting is a cycle later says little by
then. So the paths of the people followed are remembered, and each stretch of a walk is held against all of them when
it is known: one small filter of heading bias and stride scale per device and person, against a stranger's walk. The
filters and the reader of walks are those of the ``evidence`` tracker; the original compares with predictions alone.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.fusion.walks.columns import Columns
from services.fusion.walks.motion_evidence import WalkFilters
from services.fusion.walks.stretches import Walk, stretches
from shared.messages import MotionBatch

__all__ = ["WalkEvidence"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

KEPT = 8.0
"""Seconds for which paths that ended and stretches that wait are kept."""
BLOCK = 8
"""Devices are added in blocks."""


class WalkEvidence:
    """Walks of devices against the paths of links."""

    def __init__(self) -> None:
        self._columns = Columns(KEPT)
        self._filters = WalkFilters.new(0, 0)
        self._devices: list[str | None] = []
        self._waiting: dict[str, list[Walk]] = {}
        self._stepped: dict[str, float] = {}
        self._told_until: dict[str, float] = {}

    def follow(self, t: float, link: Indices, places: Array) -> None:
        """Note where (n,) links are at ``t``: (n, 2) metres; a time before the newest is too late to be of use."""
        if t < self._columns.history.newest:
            return
        _, began = self._columns.follow(t, link, places, np.zeros(len(link), np.bool_))
        if len(self._columns.tracks) > self._filters.bias.shape[1]:
            self._filters.resize(len(self._devices), len(self._columns.tracks))
        for column in began.tolist():
            self._filters.reset_track(column)

    def take(self, batch: MotionBatch) -> bool:
        """Note what a phone tells of its walk; False if it was told before: it must not count twice."""
        if batch.t <= self._told_until.get(batch.device, -math.inf):
            return False
        self._told_until[batch.device] = batch.t
        walks = stretches(batch, self._stepped.get(batch.device, -math.inf))
        if walks and walks[-1].length > 0.0:
            self._stepped[batch.device] = walks[-1].t
        waiting = self._waiting.get(batch.device, []) + walks
        self._waiting[batch.device] = [walk for walk in waiting if walk.t > batch.t - KEPT]
        return True

    def of_cycle(self, devices: list[str], t: float, link: Indices) -> Array:
        """Return (X, d) what the stretches told and ended by ``t`` say for each of (d,) links, nats."""
        tracks = self._columns.tracks
        evidence = np.zeros((len(devices), len(tracks) + 1))
        for index, device in enumerate(devices):
            waiting = self._waiting.get(device, [])
            self._waiting[device] = [walk for walk in waiting if walk.t > t]
            for walk in waiting:
                if walk.t <= t:
                    self._weigh(self._row(device), walk, evidence[index])
        # The last column is for links whose path is not known.
        columns = np.array([self._columns.find(one) for one in link.tolist()], np.int64)
        return evidence[:, columns]

    def forget(self, device: str) -> None:
        """Forget a device."""
        self._waiting.pop(device, None)
        self._stepped.pop(device, None)
        self._told_until.pop(device, None)
        if device in self._devices:
            row = self._devices.index(device)
            self._devices[row] = None
            self._filters.reset_device(row)

    def state(self) -> dict[str, Any]:
        """Return a copy of all that is known."""
        rows, columns = np.arange(len(self._devices)), np.arange(len(self._columns.tracks))
        return {
            "columns": self._columns.state(),
            "filters": self._filters.state(rows, columns),
            "devices": list(self._devices),
            "waiting": {device: [_told(walk) for walk in walks] for device, walks in self._waiting.items()},
            "stepped": dict(self._stepped),
            "told_until": dict(self._told_until),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            KeyError, TypeError, ValueError: it is no such state.
        """
        self._columns.restore(state["columns"])
        self._devices = [None if device is None else str(device) for device in state["devices"]]
        rows, columns = np.arange(len(self._devices)), np.arange(len(self._columns.tracks))
        self._filters = WalkFilters.new(len(rows), len(columns))
        self._filters.restore(state["filters"], rows, columns)
        self._waiting = {device: [_walk(told) for told in walks] for device, walks in state["waiting"].items()}
        self._stepped = {str(device): float(t) for device, t in state["stepped"].items()}
        self._told_until = {str(device): float(t) for device, t in state["told_until"].items()}

    def _weigh(self, row: int, walk: Walk, evidence: Array) -> None:
        """Add what a stretch says for each column."""
        self._filters.begin(row, walk)
        moved = self._columns.history.at(walk.t) - self._columns.history.at(walk.t_start)
        alive = self._columns.alive
        known = alive[alive < len(moved)]
        known = known[np.isfinite(moved[known, 0])]
        if len(known):
            evidence[known] += self._filters.walk(row, known, walk, moved[known])

    def _row(self, device: str) -> int:
        if device in self._devices:
            return self._devices.index(device)
        if None not in self._devices:
            self._devices += [None] * BLOCK
            self._filters.resize(len(self._devices), len(self._columns.tracks))
        row = self._devices.index(None)
        self._devices[row] = device
        self._filters.reset_device(row)
        return row


def _told(walk: Walk) -> dict[str, float | None]:
    values = {name: float(getattr(walk, name)) for name in Walk.__slots__}
    return {name: value if math.isfinite(value) else None for name, value in values.items()}


def _walk(told: dict[str, float | None]) -> Walk:
    values = {name: math.nan if value is None else float(value) for name, value in told.items()}
    number = int(values.pop("number"))
    return Walk(**values, number=number)
