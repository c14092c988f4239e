"""Is one device heard in two places at once? Then two phones use one token, and neither can be located.

A rough place comes from each scan by itself: the mean of the access points heard, weighted by received power. One
place may be wrong by metres, so only a leap there *and back*, both much farther than that and faster than anybody
runs, counts.
"""

from __future__ import annotations

import numpy as np

from shared.messages import RadioScan
from shared.radio import PathLoss

__all__ = ["TwoPlaces"]

LEAP = 15.0
"""Metres that count as another place; back within half of it is the same place again."""
WITHIN = 10.0
"""Seconds between the first and the last of three scans."""
LEAST_READINGS = 2
REMEMBERED = 10_000
"""Devices."""
BLUR = 15.0
"""dB per factor of ten in weight: less steep than power itself, lest the one strongest reading speak alone."""


class TwoPlaces:
    """Watches the scans of all devices of one floor."""

    def __init__(self, radio: PathLoss) -> None:
        self._place = {name: tuple(spot[:2]) for name, spot in zip(radio.names, radio.positions.tolist(), strict=True)}
        self._last: dict[str, list[tuple[float, float, float]]] = {}

    def contradicts(self, scan: RadioScan) -> bool:
        """Note a scan; whether it completes a leap there and back."""
        heard = [
            (*self._place[name], level)
            for name, level in zip(scan.access_point, scan.rssi, strict=True)
            if name in self._place and -120.0 <= level <= 0.0
        ]
        if len(heard) < LEAST_READINGS:
            return False
        x, y, level = np.array(heard).T
        weight = 10.0 ** ((level - level.max()) / BLUR)
        here = (scan.t, float(weight @ x / weight.sum()), float(weight @ y / weight.sum()))
        if len(self._last) >= REMEMBERED and scan.device not in self._last:
            del self._last[next(iter(self._last))]
        before = self._last.setdefault(scan.device, [])
        before.append(here)
        if len(before) < 3:
            return False
        first, between, last = before[-3:]
        del before[:-2]
        return (
            0.0 <= last[0] - first[0] <= WITHIN
            and _apart(first, between) > LEAP
            and _apart(between, last) > LEAP
            and _apart(first, last) < 0.5 * LEAP
        )

    def forget(self, device: str) -> None:
        """Forget a device whose consent was withdrawn."""
        self._last.pop(device, None)


def _apart(one: tuple[float, float, float], other: tuple[float, float, float]) -> float:
    return float(np.hypot(one[1] - other[1], one[2] - other[2]))
