"""What the identity filter asks of its area: expected signal strengths, who is in view, where a phone may be at all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from services.fusion.area_view import AreaView
from services.fusion.rbmcda.settings import RbmcdaSettings

__all__ = ["Surroundings"]

Array = NDArray[np.float64]

CELL = 1.0
"""Metres between the places at which a new phone may be, unless the floor is very large."""
MOST_PLACES = 4000
LEARNED = 1.0
"""dB that a learned map leaves open of what an access point sends."""


class Surroundings:
    """Static knowledge of an area, prepared once.

    Attributes:
        grid: (g, 2) places all over the floor, metres.
        expected_on_grid: (g, M) dBm.
        shared: dB², of it what an access point is off for all phones.
        bias: (M, M) dB², how wrong ``expected`` may be for one phone at one place.
    """

    def __init__(self, view: AreaView, settings: RbmcdaSettings) -> None:
        self._view = view
        noise = settings.noise
        lower, upper = view.plan.outline.bounds[:2], view.plan.outline.bounds[2:]
        extent = np.subtract(upper, lower)
        cell = max(CELL, float(np.sqrt(extent.prod() / MOST_PLACES)))
        axes = [np.arange(low + 0.5 * cell, high, cell) for low, high in zip(lower, upper, strict=True)]
        x, y = np.meshgrid(*axes)
        places = np.column_stack([x.ravel(), y.ravel()])
        self.grid: Array = places[view.plan.contains(places)]
        if not len(self.grid):
            self.grid = places
        count = len(view.radio.names)
        shadowing, constant = np.full(count, noise.shadowing**2), noise.access_point**2
        if view.shadowing is not None:
            shadowing, constant = view.shadowing.at(self.grid)[1].mean(axis=0), LEARNED**2
        self.shared = constant
        self.bias: Array = np.diag(constant + shadowing) + noise.device**2
        of_placed = shadowing[view.radio.placed]
        total = float((constant + of_placed).mean()) + noise.device**2 if len(of_placed) else 0.0
        self._local = float(of_placed.mean()) / total if total > 0.0 else 0.0
        self._range, self._memory = noise.shadowing_range, settings.shadowing_memory
        self.expected_on_grid: Array = self.expected(self.grid)
        self._areas: dict[frozenset[str], float] = {}

    def expected(self, places: Array) -> Array:
        """Return (n, M) dBm at (n, 2) places."""
        level = self._view.radio.rssi(places)
        if self._view.shadowing is not None:
            level = level + self._view.shadowing.at(places)[0]
        return level

    def kept(self, path: Array, duration: float) -> Array:
        """Return how alike biases are before and after (X,) metres in so many seconds: shadowing fades on the way."""
        faded = np.exp(-path / self._range - duration / self._memory)
        kept: Array = 1.0 - self._local * (1.0 - faded)
        return kept

    def in_view(self, cameras: set[str], places: Array) -> Array:
        """Return (n,) 1 where one of these cameras sees (n, 2) places, less in the half metre before its border."""
        deepest = np.full(len(places), -np.inf)
        for camera in sorted(cameras):
            deepest = np.maximum(deepest, self._view.views[camera].depth_at(places))
        share: Array = np.minimum(np.maximum(deepest / 0.5, 0.0), 1.0)
        return share

    def floor_seen(self, cameras: set[str]) -> float:
        """Return how many square metres these cameras see, together."""
        chosen = frozenset(cameras)
        if chosen not in self._areas:
            seen = np.logical_or.reduce([self._view.views[camera].depth > 0.0 for camera in chosen])
            cell = next(iter(self._view.views.values())).cell
            self._areas[chosen] = max(float(seen.sum()) * cell**2, 1.0)
        return self._areas[chosen]
