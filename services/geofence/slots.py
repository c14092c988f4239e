"""Which person has which slot of the arrays, under whatever number of track, and where they were last."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Slots"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

ELSEWHERE = -2
"""A floor nobody is on: whoever comes from there has made no step."""
_FIRST_CAPACITY = 64
PLACE = np.dtype([("t", float), ("x", float), ("y", float), ("floor", np.int64), ("who", np.int64), ("spread", float)])
"""When and where a track was last, who it is, and how well the place was known: metres, standard deviation."""


class Slots:
    """Tracks by number. A new track takes over the slot of the newest of its former ids that is no longer reported."""

    def __init__(self) -> None:
        self.ids = np.empty(0, np.int64)
        """(k,) numbers of the tracks that are remembered, sorted."""
        self.slot_of_id = np.empty(0, np.int64)
        """(k,)."""
        self.place = np.zeros(0, PLACE)
        """By slot."""
        self._free: list[int] = []
        self._people = 0

    def take(self, track: Ints, former: Sequence[Sequence[int]], others: Ints) -> tuple[Ints, Bools]:
        """Return the slot of each track (n,), made where it has none, and whether its place before is known (n,).

        ``others`` (o,) are reported besides.
        """
        at = np.searchsorted(self.ids, track)
        known = np.zeros(len(track), np.bool_)
        within = at < len(self.ids)
        known[within] = self.ids[at[within]] == track[within]
        if not known.all():
            self._admit(track, np.flatnonzero(~known), former, {*track.tolist(), *others.tolist()})
            at = np.searchsorted(self.ids, track)
        slot = self.slot_of_id[at]
        return slot, np.isfinite(self.place["t"][slot])

    def hold(self, t: float, track: Ints, former: Sequence[Sequence[int]], others: Ints) -> None:
        """Leave tracks where they were, present at ``t``; ``others`` (o,) are reported besides."""
        present = {*track.tolist(), *others.tolist()}
        slots = self.by_id()
        for row, number in enumerate(track.tolist()):
            if number not in slots:
                heir = _heir(former[row], slots, present)
                if heir is None:
                    continue
                slots[number] = slots.pop(heir)
            self.place["t"][slots[number]] = t
            self.place["floor"][slots[number]] = ELSEWHERE
        self._index(slots)

    def stale(self, former: Sequence[Sequence[int]], present: set[int]) -> set[int]:
        """Return the tracks remembered that others name as former and nobody reports."""
        named = {one for earlier in former for one in earlier}
        return (named & set(self.ids.tolist())).difference(present) if named else set()

    def drop(self, places: Ints) -> None:
        """Forget the tracks at these places of ``ids``."""
        for slot in self.slot_of_id[places].tolist():
            heapq.heappush(self._free, slot)
        self.ids = np.delete(self.ids, places)
        self.slot_of_id = np.delete(self.slot_of_id, places)

    def by_id(self) -> dict[int, int]:
        """Return the slots by track."""
        return dict(zip(self.ids.tolist(), self.slot_of_id.tolist(), strict=True))

    def state(self) -> dict[str, Any]:
        """Return what ``restore`` takes, in plain values."""
        return {
            "ids": self.ids.tolist(),
            "places": self.place[self.slot_of_id].tolist(),
            "slots": self.slot_of_id.tolist(),
            "people": self._people,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Be as another was when its ``state`` was taken.

        Raises:
            ValueError, TypeError, KeyError: it is no such state.
        """
        slots = dict(zip(state["ids"], state["slots"], strict=True))
        while len(self.place) <= max(slots.values(), default=0):
            self._grow()
        taken = set(slots.values())
        if len(taken) != len(slots) or min(taken, default=0) < 0:
            raise ValueError("a slot is taken twice")
        self._free = [slot for slot in range(len(self.place)) if slot not in taken]
        self.place[list(slots.values())] = [tuple(place) for place in state["places"]]
        self._people = int(state["people"])
        self._index(slots)

    def _admit(self, track: Ints, new: Ints, former: Sequence[Sequence[int]], present: set[int]) -> None:
        slots = self.by_id()
        for row in new.tolist():
            heir = _heir(former[row] if row < len(former) else (), slots, present)
            if heir is not None:
                slots[int(track[row])] = slots.pop(heir)
                continue
            if not self._free:
                self._grow()
            slot = heapq.heappop(self._free)
            self._people += 1
            self.place[slot] = (np.nan, np.nan, np.nan, ELSEWHERE, self._people, 0.0)
            slots[int(track[row])] = slot
        self._index(slots)

    def _index(self, slots: dict[int, int]) -> None:
        ids = np.fromiter(slots.keys(), np.int64, len(slots))
        order = np.argsort(ids)
        self.ids = ids[order]
        self.slot_of_id = np.fromiter(slots.values(), np.int64, len(slots))[order]

    def _grow(self) -> None:
        old = len(self.place)
        grown = np.zeros(max(2 * old, _FIRST_CAPACITY), PLACE)
        grown[:old] = self.place
        self.place = grown
        self._free.extend(range(old, len(grown)))


def _heir(earlier: Sequence[int], slots: dict[int, int], present: set[int]) -> int | None:
    return next((one for one in reversed(earlier) if one in slots and one not in present), None)
