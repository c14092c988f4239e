"""Which tracks are one person? Those that carried the same phone, as far as that is known."""

from __future__ import annotations

from collections import Counter, defaultdict
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
    """Tells whose a track is: that of the phone it carried longest, which no other track carried meanwhile.

    Of two tracks that were there together only the one that carried a phone for longer is its carrier's: nobody is in
    two places. A track is never divided: where names change on it, one of them was wrong. Nothing is joined because it
    is near in place and time.

    Args:
        carried: device, area, and ``carried_by`` of its minutes.
        lives: area and number of each track, its first and last minute.
    """

    def __init__(self, carried: Iterable[tuple[str, str, str]], lives: Iterable[tuple[str, str, int, int]]) -> None:
        points: dict[Track, Counter[str]] = defaultdict(Counter)
        for device, area, text in carried:
            for number, n in carriers_of(text):
                points[area, number][device] += n
        lived = {(area, number): (first, last) for area, number, first, last in lives}
        claims = [(n, device, track) for track, of in points.items() for device, n in of.most_common(1)]
        self._device: dict[Track, str] = {}
        taken: dict[str, list[tuple[int, int]]] = defaultdict(list)
        for _, device, track in sorted(claims, reverse=True):
            first, last = lived.get(track, (0, -1))
            # Two tracks may share the minute in which one was lost and the other found.
            if all(last <= begin or end <= first for begin, end in taken[device]):
                taken[device].append((first, last))
                self._device[track] = device

    def device(self, area: str, track: str) -> str | None:
        """Return the phone whose carrier a track was; None: nobody's that is known."""
        return self._device.get((area, track))
