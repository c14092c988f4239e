"""What has held for a while, once per episode: a crowd, somebody too fast, two people too near each other."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

__all__ = ["Episodes"]

K = TypeVar("K")


@dataclass
class _Episode:
    since: float
    last: float
    told: bool = False


class Episodes(Generic[K]):
    """Things that begin to hold, hold, and end.

    Args:
        least: seconds on end for which something must hold to be an episode.
        rest: seconds for which it must not hold to be over; until then it is the same episode.
    """

    def __init__(self, least: float, rest: float) -> None:
        self._least = least
        self._rest = rest
        self._known: dict[K, _Episode] = {}

    def step(self, t: float, holding: Iterable[K]) -> list[tuple[K, float]]:
        """Return the episodes that are certain by ``t`` and were not before, and since when each has held."""
        begun = []
        for key in holding:
            episode = self._known.get(key)
            if episode is None or (not episode.told and t - episode.last > self._least):
                episode = self._known[key] = _Episode(t, t)
            episode.last = t
            if not episode.told and t - episode.since >= self._least:
                episode.told = True
                begun.append((key, episode.since))
        for key in [key for key, episode in self._known.items() if t - episode.last > self._rest]:
            del self._known[key]
        return begun

    def clear(self) -> None:
        """Forget all: time begins anew."""
        self._known.clear()

    def state(self) -> list[tuple[K, float, float, bool]]:
        """Return what ``restore`` takes."""
        return [(key, one.since, one.last, one.told) for key, one in self._known.items()]

    def restore(self, state: Iterable[tuple[K, float, float, bool]]) -> None:
        """Be as another was when its ``state`` was taken."""
        self._known = {key: _Episode(since, last, told) for key, since, last, told in state}
