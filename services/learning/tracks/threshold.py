"""From which quality on is a track to be trusted? Chosen from what the same phones score on other people's tracks.

The threshold of the sheet is unpublished [ravel-thesis §8.1]. But what a wrong name scores can be seen at any time:
the phone is held against somebody else who was about, through all the other checks as well (``REFUSED``). How many
names are wrong at all is read off the low scores, which wrong ones alone explain (Storey, 2002); so the threshold is
the least one at which no more than ``WRONG`` of what passes is expected to be wrong (target and decoy; Elias and
Gygi, 2007). Where that never is so, nothing passes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

__all__ = ["REFUSED", "Threshold"]

REFUSED = -1e3
"""The score of what was refused for another reason: it passes at no threshold."""

HISTORY = 300
"""Scores remembered, of own and of other tracks."""
ENOUGH = 20
"""Scores of each kind from which on they decide."""
WRONG = 0.1
"""Largest share of wrong ones among those that pass."""
LEAST = 0.15
"""Share of the scores that must pass, or none may: fewer are luck."""


class Threshold:
    """Chooses the least score that is good enough.

    Args:
        first: the threshold until enough scores are known, and never less than that.
    """

    def __init__(self, first: float) -> None:
        self._first = first
        self._own: deque[float] = deque(maxlen=HISTORY)
        self._other: deque[float] = deque(maxlen=HISTORY)
        self._value: float | None = None

    def add(self, own: float, other: float | None) -> None:
        """Take in a score on a phone's own track, and one on somebody else's where there was anybody."""
        self._own.append(own)
        if other is not None:
            self._other.append(other)
        self._value = None

    @property
    def value(self) -> float:
        """The threshold; infinity where everything looks bad."""
        if self._value is None:
            self._value = self._chosen()
        return self._value

    def state(self) -> dict[str, Any]:
        """Return all that is remembered."""
        return {"own": list(self._own), "other": list(self._other)}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            KeyError, TypeError, ValueError: it is no such state.
        """
        own, other = ([float(score) for score in state[name]] for name in ("own", "other"))
        self._own, self._other = deque(own, maxlen=HISTORY), deque(other, maxlen=HISTORY)
        self._value = None

    def _chosen(self) -> float:
        if len(self._own) < ENOUGH or len(self._other) < ENOUGH:
            return self._first
        own, other = np.sort(self._own), np.sort(self._other)
        low = float(np.median(other))
        explained = float(np.searchsorted(other, low, side="right")) / len(other)
        wrong = min(float(np.searchsorted(own, low, side="right") + 1) / len(own) / explained, 1.0)
        passing = 1.0 - np.arange(len(own)) / len(own)
        by_chance = wrong * (1.0 - np.searchsorted(other, own, side="left") / len(other))
        fine = np.flatnonzero((by_chance <= WRONG * passing) & (passing >= LEAST) & (own >= self._first))
        return float(own[fine[0]]) if len(fine) else math.inf
