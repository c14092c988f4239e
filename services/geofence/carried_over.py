"""What is remembered of tracks near borders, when the borders become others."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.geofence.pairs import PAIR
from services.geofence.zone_index import ZoneIndex

__all__ = ["carried_over"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def carried_over(
    pairs: NDArray[Any],
    old: ZoneIndex,
    new: ZoneIndex,
    becomes: Mapping[int, int],
    unchanged: Collection[int],
    tracks: tuple[Ints, Floats, Floats, Ints],
) -> tuple[NDArray[Any], Ints]:
    """Return the pairs before the new borders, and those of the old ones whose track is inside no more.

    A border that keeps its shape keeps all that is remembered. Of one that changed those inside stay inside unless its
    new shape is out of their reach; the next frames decide the rest. Whoever a new or changed area lies around is
    inside of it.

    Args:
        pairs: (m,) of ``PAIR``, sorted by code.
        old: borders they are of.
        new: the others.
        becomes: which old border is which new one.
        unchanged: the old borders that keep their shape.
        tracks: slot, x, y and number of the floor in the new index (-1: on none of its floors) of each track.

    Returns:
        pairs: (k,) of ``PAIR``, sorted by code.
        left: codes of the old pairs.
    """
    slot, x, y, floor = tracks
    known = np.flatnonzero(floor >= 0)
    row, border, depth, _ = new.nearby(x[known], y[known], floor[known])
    codes = slot[known[row]] * len(new) + border
    near = set(codes.tolist())
    kept: dict[int, Any] = {}
    left: list[int] = []
    unknown = set(slot[floor < 0].tolist())
    for pair in pairs:
        of, before = divmod(int(pair["code"]), len(old))
        now = becomes.get(before)
        if now is None:
            continue
        code = of * len(new) + now
        if before in unchanged:
            kept[code] = pair
        elif pair["side"] > 0 and not old.is_line[before]:
            # Whose place is not known stays where they were.
            if code in near or of in unknown:
                kept[code] = _inside()
            else:
                left.append(int(pair["code"]))
    same = {becomes[before] for before in unchanged if before in becomes}
    for code in codes[(depth >= 0.0) & ~new.is_line[border]].tolist():
        if code % len(new) not in same:
            kept[code] = _inside()
    carried = np.zeros(len(kept), PAIR)
    for place, code in enumerate(sorted(kept)):
        carried[place] = kept[code]
        carried["code"][place] = code
    return carried, np.array(left, np.int64)


def _inside() -> Any:
    inside = np.zeros((), PAIR)
    inside["side"] = 1
    return inside
