"""What pushes people in one area: the plan, and what the cameras teach of where nobody walks [ravel-thesis §8.5]."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.fusion.area_view import AreaView
from services.fusion.forces import Obstacles
from services.fusion.snapshot import unpack
from shared.occlusion_map import OcclusionMap

__all__ = ["LearnedObstacles"]

REBUILD = 60.0
"""Seconds between two looks at the map."""


class LearnedObstacles:
    """The obstacles of an area, kept up with its occlusion map.

    Attributes:
        obstacles: as of the last look at the map.
    """

    def __init__(self, view: AreaView) -> None:
        self._view = view
        self._t = self._built = -math.inf
        self._map = OcclusionMap(view.lower, view.upper)
        centres = self._map.centres()
        depth = view.everywhere.depth_at(centres.reshape(-1, 2))
        self._visible: NDArray[np.bool_] = (depth > 0.0).reshape(centres.shape[:2])
        self._build(np.zeros_like(self._visible))

    def add(self, t: float, places: NDArray[np.float64]) -> None:
        """Count people seen at ``t`` seconds at (n, 2) places, metres; a clock set back starts the map anew."""
        if t < self._t:
            self._map, self._built = OcclusionMap(self._view.lower, self._view.upper), -math.inf
            self._build(np.zeros_like(self._cells))
        self._t = t
        self._map.add(t, places)
        if not math.isfinite(self._built):
            self._built = t
        elif t - self._built >= REBUILD:
            self._built = t
            cells = self._map.blocked_cells(self._visible)
            if (cells != self._cells).any():
                self._build(cells)

    def state(self) -> dict[str, Any]:
        """Return a copy of all that was learned."""
        learned = self._map.state()
        return {
            "t": self._t if math.isfinite(self._t) else None,
            "built": self._built if math.isfinite(self._built) else None,
            "cells": self._cells.copy(),
            "lower": learned["lower"],
            "faded": learned["faded"],
            "visits": np.array(learned["visits"]),
            "last": np.array(learned["last"], dtype=np.float64),  # NaN for never
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            KeyError, TypeError, ValueError: it is no such state, or of another floor.
        """
        learned, cells, last = OcclusionMap(self._view.lower, self._view.upper), unpack(state["cells"]), state["last"]
        never = [[None if math.isnan(t) else t for t in row] for row in unpack(last).tolist()]
        visits = unpack(state["visits"]).tolist()
        learned.restore({"lower": state["lower"], "faded": state["faded"], "visits": visits, "last": never})
        if cells.shape != self._cells.shape:
            raise ValueError(f"blocked cells {cells.shape} of another floor, this one has {self._cells.shape}")
        t, built = (-math.inf if state[name] is None else float(state[name]) for name in ("t", "built"))
        self._map, self._t, self._built = learned, t, built
        self._build(cells)

    def _build(self, cells: NDArray[np.bool_]) -> None:
        self._cells: NDArray[np.bool_] = cells
        self.obstacles = Obstacles.of_plan(self._view.plan, self._map.shape_of(cells))
