"""A seeded crowd on the floors of a site: who is where at any time, from the world's first second on.

What they do comes from ``crowd_steps``, one fixed step after another; this lets them go on as far as somebody asks, and
remembers. The same seed walks the same way however often time is asked for, and in every process.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from services.simulator.crowd.crowd_steps import CrowdSteps
from services.simulator.crowd.walk_history import WalkHistory
from services.simulator.crowd.walker_parameters import Door, WalkerParameters
from services.simulator.crowd.walking import STEP
from services.simulator.people import Movement
from shared.site import FloorPlan

__all__ = ["STEP", "Crowd", "Door", "WalkerParameters"]

Array = NDArray[np.float64]


class Crowd:
    """People who walk on the plans of one or more floors (the ``People`` of a simulated world).

    Args:
        plans: the floors by id.
        parameters: who they are and what they do.
        seed: of everything.

    Raises:
        ValueError: nobody could walk or come in here, or a door is where none can be.
    """

    def __init__(self, plans: Mapping[str, FloorPlan], parameters: WalkerParameters, seed: int) -> None:
        self._steps = CrowdSteps(plans, parameters, seed)
        self._history = WalkHistory(len(self._steps.persons), STEP)
        self._lock = threading.Lock()  # renderer, phones and truth ask from threads of their own

    @property
    def persons(self) -> Sequence[str]:
        """``person-1``, ``person-2``, …; the first ones carry phones."""
        return self._steps.persons

    @property
    def floors(self) -> Sequence[str]:
        """Ids of the floors."""
        return self._steps.floors

    def groups(self) -> list[list[int]]:
        """Return who walk together at the latest step, places in ``persons``."""
        with self._lock:
            self._set_off()
            return [list(group) for group in self._steps.companions.groups()]

    def movement(self, times: Array, persons: Sequence[int] | NDArray[np.int64] | None = None) -> Movement:
        """Return how people moved at increasing ``times`` (n,), walking on as far as needed.

        What lies more than a minute and a half ago is unknown (NaN, -1).
        """
        times = np.asarray(times, float)
        index = None if persons is None else np.asarray(persons, dtype=np.int64)
        with self._lock:
            self._set_off()
            needed = self._history.needed(float(times[-1])) if len(times) else 0
            while self._steps.number < needed:
                self._steps.step()
                self._history.record(*self._steps.state())
            moved = self._history.movement(times, index)
        for number, space in enumerate(self._steps.spaces):
            # Between two steps somebody may have crossed the door's line.
            there = moved.present & (moved.floor == number)
            moved.present[there] &= space.plan.contains(moved.position[there])
        return moved

    def instants(self, after: float, until: float) -> Array:
        """Return the crowd's own steps in (after, until]."""
        first = max(0, math.floor(after / STEP + 1e-9) + 1)
        chosen: Array = np.arange(first, math.floor(until / STEP + 1e-9) + 1) * np.float64(STEP)
        return chosen

    def _set_off(self) -> None:
        """Let people walk themselves in before second zero, once somebody asks: who only checks a scenario does not."""
        if self._steps.number < 0:
            while self._steps.number < 0:
                self._steps.step()
            self._history.record(*self._steps.state())
