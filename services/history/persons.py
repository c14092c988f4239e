"""Which tracks are one person? Those that carried the same phone, minute by minute, as far as that is known."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

__all__ = ["Persons", "carried_by", "carriers_of"]

Track = tuple[str, str]
"""Area and number."""


def carried_by(block: NDArray[np.int32]) -> str:
    """Return which tracks carried the device of a block, shape (7, n), for how many points each: ``7:41 9:19``."""
    return " ".join(f"{track}:{n}" for track, n in sorted(Counter(block[5].tolist()).items()) if track)


def carriers_of(text: str) -> list[tuple[str, int]]:
    """Return tracks and how many points each, as ``carried_by`` writes them."""
    return [(track, int(n)) for track, _, n in (part.partition(":") for part in text.split())]


class Persons:
    """Tells whose minutes a track's are.

    A minute in which a track carried a phone is that phone's. A minute without a name is that of the name next to it in
    time on the same track, unless another track carried that phone then: who is elsewhere is not here. All else stays
    the track's own: nothing is joined because it is near in place and time.

    Args:
        rows: device, minute, area, and ``carried_by`` of that minute.
    """

    def __init__(self, rows: Iterable[tuple[str, int, str, str]]) -> None:
        most: dict[tuple[Track, int], tuple[int, str]] = {}
        self._elsewhere: set[tuple[str, int]] = set()
        for device, minute, area, text in rows:
            for number, n in carriers_of(text):
                self._elsewhere.add((device, minute))
                key = (area, number), minute
                most[key] = max(most.get(key, (0, "")), (n, device))
        self._named = {key: device for key, (_, device) in most.items()}
        self._minutes: dict[Track, list[int]] = {}
        for track, minute in self._named:
            self._minutes.setdefault(track, []).append(minute)
        for minutes in self._minutes.values():
            minutes.sort()

    def device(self, area: str, track: str, minute: int) -> str | None:
        """Return the phone whose carrier this minute of a track was; None: nobody's that is known."""
        of = area, track
        named = self._named.get((of, minute))
        minutes = self._minutes.get(of)
        if named is not None or minutes is None:
            return named
        place = bisect_left(minutes, minute)
        for near in sorted(minutes[max(place - 1, 0) : place + 1], key=lambda known: abs(known - minute)):
            device = self._named[of, near]
            if (device, minute) not in self._elsewhere:
                return device
        return None
