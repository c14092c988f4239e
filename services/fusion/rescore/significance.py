"""How far off may a gain be? Standard errors of a mean over readings that come in blocks.

Readings of one device within half a minute are alike in what is wrong with them, so blocks of them are the units that
vary. Where a device's blocks are alike too, its whole time is one unit; the larger of both errors is told.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping

__all__ = ["SLOT", "gain_error", "rate_error"]

SLOT = 30.0
"""Seconds of a block."""
ENOUGH = 5
"""Devices from which on they are taken for units too."""

Block = tuple[str, int]
"""A device and the number of a block of time."""


def gain_error(gain: Mapping[Block, float], readings: Mapping[Block, int]) -> float | None:
    """Return the standard error of the sum of ``gain`` by the sum of ``readings``; None where it cannot be told.

    Delete-one jackknife of a ratio, linearised: over blocks, and over devices where there are enough.
    """
    by_device: dict[str, float] = defaultdict(float)
    count: dict[str, int] = defaultdict(int)
    for block in readings:
        by_device[block[0]] += gain.get(block, 0.0)
        count[block[0]] += readings[block]
    error = _ratio_error([(gain.get(block, 0.0), readings[block]) for block in readings])
    if error is None or len(count) < ENOUGH:
        return error
    return max(error, _ratio_error([(by_device[device], count[device]) for device in count]) or 0.0)


def rate_error(gain: Mapping[int, float], since: float, until: float) -> float | None:
    """Return the standard error of a gain per second over blocks of the time from ``since`` to ``until``, or None."""
    blocks = range(math.floor(since / SLOT), math.ceil(until / SLOT))
    lasted = {slot: min((slot + 1) * SLOT, until) - max(slot * SLOT, since) for slot in blocks}
    return _ratio_error([(gain.get(slot, 0.0), lasted[slot]) for slot in blocks])


def _ratio_error(units: list[tuple[float, float]]) -> float | None:
    total = sum(size for _, size in units)
    if len(units) < 2 or not total:
        return None
    mean = sum(gain for gain, _ in units) / total
    squares = sum((gain - mean * size) ** 2 for gain, size in units)
    return math.sqrt(squares * len(units) / (len(units) - 1)) / total
