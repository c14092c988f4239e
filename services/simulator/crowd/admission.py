"""Who comes in when, and who is asked to go? The number of people inside wanders slowly between its two bounds."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from services.simulator.crowd.walker_parameters import WalkerParameters
from services.simulator.seeds import generator

__all__ = ["Admission"]

_WANDER_SECONDS = 240.0
_WANDER = 0.32  # standard deviation, as a share of the range


class Admission:
    """Comings and goings.

    Args:
        parameters: how many are inside at a time, groups, time away.
        seed: of the world.
    """

    def __init__(self, parameters: WalkerParameters, seed: int) -> None:
        self._parameters = parameters
        self.rng = generator(seed, "crowd", "admission")
        self._share = float(self.rng.normal(0.5, _WANDER))
        self._back = np.full(parameters.pool, -math.inf)
        self._size = self.group_size()

    def wanted(self, dt: float) -> int:
        """Return how many should be inside, ``dt`` seconds after the last time this was asked."""
        keep = math.exp(-dt / _WANDER_SECONDS)
        self._share = 0.5 + keep * (self._share - 0.5) + math.sqrt(1.0 - keep**2) * self.rng.normal(0.0, _WANDER)
        low, high = self._parameters.present
        return int(np.clip(round(low + self._share * (high - low)), max(low, 1), high))

    def left(self, person: int, t: float) -> None:
        """Take note that a person left; who carries a phone comes back sooner."""
        low, high = self._parameters.away
        most = 0.5 * (low + high) if person < self._parameters.carriers else high
        self._back[person] = t + max(float(self.rng.uniform(low, most)), 1.0)

    def first(self, count: int) -> list[int]:
        """Return who is inside when the world begins: carriers first, then anybody."""
        carriers, pool = self._parameters.carriers, self._parameters.pool
        others = carriers + self.rng.permutation(pool - carriers)
        return [*range(carriers), *others.tolist()][: max(count, carriers)]

    def next(self, t: float, away: NDArray[np.bool_], missing: int, most: int) -> list[int]:
        """Return who comes in together now, if anybody.

        Args:
            t: seconds.
            away: (p,) who is outside.
            missing: how many people there are too few inside; a group comes when half of it is missing, a carrier
                as soon as there is room.
            most: how many may come in.
        """
        ready = np.flatnonzero(away & (self._back <= t))
        carriers = ready[ready < self._parameters.carriers]
        size = min(self._size, len(ready))
        if len(carriers):
            size = min(size, max(missing, 1), most)
        elif size > most or missing < (size + 1) // 2:
            return []
        if size < 1:
            return []
        self._size = min(self.group_size(), self._parameters.present[1])
        others = ready[ready >= self._parameters.carriers]
        chosen = [*carriers[:1].tolist(), *self.rng.permutation(others).tolist()][:size]
        self.rng.shuffle(chosen)
        return chosen

    def group_size(self) -> int:
        """Return how many come together: one, or a group."""
        if self.rng.random() >= self._parameters.groups:
            return 1
        return int(self.rng.integers(*self._parameters.group_size, endpoint=True))
