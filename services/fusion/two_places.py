"""Is one device heard in two places at once? Then two phones use one token, and neither can be located.

Two accounts of a device's scans are held against each other: *one* phone, whose levels drift as fast as somebody walks,
and *two* that take turns, each of which only drifts. What a phone hears is followed as a position would be: a level for
every access point of the site, and its floor. The log-likelihood ratio of the two accounts is
summed, never below nought (Page's cumulative sum, 1954). It asks what a scatter of places cannot: whether two sets of
levels take turns while each stays like itself. A runner drifts and does not go back and forth, a shadow and weak radio
spoil both accounts alike, and a small hall or another floor differs in levels where it does not in metres. *Which*
access points a scan lists says nothing: receivers and bands may take turns as well. (Bands that differ by 8 dB from one
access point to the next are taken for two places in half of the cases.)
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from shared.messages import RadioScan
from shared.site import AccessPoint

__all__ = ["TwoPlaces"]

Array = NDArray[np.float64]
_Key = tuple[str, str, bool]
"""Device, kind of radio and who heard it: phones and receivers may list other access points in turns."""

SURE = 20.0
"""Nats by which two phones must explain more than one."""
MOST = 1.5 * SURE
"""Nats; more is not kept, so that a mended token is well again within a minute."""
TURN = float(np.log(2.0))
"""Nats two phones pay for each scan: either could have made it."""
TURNS = 6
"""How often, at least, they took turns …"""
RECENT = 16
"""… in the last so many scans."""
WHITE = 6.0
"""dB by which two readings of one place differ, be it that one band of an access point was heard and then another."""
SPREAD = 9.0
"""dB by which readings of two places far apart differ …"""
FAR = 8.0
"""… metres apart, for somebody who …"""
SPEED = 2.0
"""… moves so fast, m/s."""
DEVICE = 6.0
"""dB by which everything is louder or fainter from one scan to the next: out of a pocket, another band."""
UNHEARD = (-75.0, 12.0)
"""dBm and dB: what a phone hears of an access point it has not heard yet."""
OUTLIER = 3.0
"""Standard deviations; no reading errs by more."""
INDEPENDENT = 10
"""So many readings speak for themselves; of more, neighbours err alike."""
CEILING = 12.0
"""dB by which another floor's access points are fainter for a phone that is surely on this one."""
STAIRS = 10.0
"""Seconds sooner than which nobody is on another floor …"""
FLOOR = 4.0
"""… and the nats it costs to be there all the same."""
ANY = -1
"""Whoever stands in an atrium is on no floor."""
LEAST_READINGS = 2
FORGOTTEN = 60.0
"""Seconds of silence after which a device is new."""
PAUSE = 0.4
"""Seconds left out after every second scan: of phones that scan ten times a second a few scans are enough."""
AGAIN = 60.0
"""Seconds after which a device is worth a line in the log again."""
REMEMBERED = 2000
"""Devices."""

ONE, FIRST, SECOND, NEW = range(4)
"""Rows of a device's sources: the phone if it is one, each of two, and one that nothing was heard of yet."""


@dataclass
class _Sources:
    """What the phones that may be behind one device hear, by row.

    Attributes:
        t: (4,) time of each one's last scan, s.
        level: (4, m) dBm, and ``variance``: dB².
        floor: (4,) number of the floor; ``ANY`` where it is not known.
        ratio: nats by which two explain more than one.
        labels: whether the second made each of the last scans.
        scans: how many were looked at.
        told: when it was worth telling, s.
    """

    t: Array
    level: Array
    variance: Array
    floor: NDArray[np.int64]
    ratio: float = 0.0
    labels: tuple[bool, ...] = ()
    scans: int = 0
    told: float = -np.inf

    @classmethod
    def of(cls, points: int) -> _Sources:
        return cls(
            np.full(4, -np.inf),
            np.full((4, points), UNHEARD[0]),
            np.full((4, points), UNHEARD[1] ** 2),
            np.full(4, ANY),
        )

    def put(self, row: int, t: float, level: Array, variance: Array, floor: int) -> None:
        self.t[row], self.level[row], self.variance[row], self.floor[row] = t, level, variance, floor


class TwoPlaces:
    """Watches the scans of all devices.

    Args:
        access_points: all of the site.
    """

    def __init__(self, access_points: Sequence[AccessPoint]) -> None:
        self._column = {point.id: column for column, point in enumerate(access_points)}
        floors = sorted({point.floor for point in access_points})
        self._floor = np.array([floors.index(point.floor) for point in access_points], np.int64)
        self._devices: OrderedDict[_Key, _Sources] = OrderedDict()

    def contradicts(self, scan: RadioScan) -> bool:
        """Note a scan; whether two phones explain its device's scans far better than one."""
        key = (scan.device, scan.kind, scan.heard_by_site)
        known = self._devices.get(key)
        passed = np.inf if known is None else scan.t - float(known.t[ONE])
        if known is not None and known.scans % 2 == 0 and 0.0 <= passed < PAUSE:
            return False
        reading = self._reading(scan)
        if np.isfinite(reading).sum() < LEAST_READINGS:
            return False
        self._drop_silent(scan.t)
        if known is None or not abs(passed) <= FORGOTTEN:
            known = self._devices[key] = _Sources.of(len(self._column))
            if len(self._devices) > REMEMBERED:
                self._devices.popitem(last=False)
        self._devices.move_to_end(key)
        _compare(known, scan.t, reading, self._floor_of(reading))
        turns = sum(one != other for one, other in pairwise(known.labels))
        return known.ratio >= SURE and turns >= TURNS

    def worth_telling(self, device: str, t: float) -> bool:
        """Whether a contradiction of a device has not been told for a minute; it is now."""
        of_device = [known for key, known in self._devices.items() if key[0] == device]
        if any(0.0 <= t - known.told < AGAIN for known in of_device):
            return False
        for known in of_device:
            known.told = t
        return True

    def forget(self, device: str) -> None:
        """Forget a device whose consent was withdrawn."""
        for key in [key for key in self._devices if key[0] == device]:
            del self._devices[key]

    def _drop_silent(self, t: float) -> None:
        """Keep nothing of who has been silent for long."""
        while self._devices and next(iter(self._devices.values())).t[ONE] < t - FORGOTTEN:
            self._devices.popitem(last=False)

    def _reading(self, scan: RadioScan) -> Array:
        """Return (m,) dBm; NaN for what was not heard."""
        reading = np.full(len(self._column), np.nan)
        for name, level in zip(scan.access_point, scan.rssi, strict=True):
            if name in self._column and -120.0 <= level <= 0.0:
                reading[self._column[name]] = level
        return reading

    def _floor_of(self, reading: Array) -> int:
        """Return the floor whose access points are heard by far the strongest; ``ANY`` where none is."""
        loudest = int(np.nanargmax(reading))
        others = reading[(self._floor != self._floor[loudest]) & np.isfinite(reading)]
        return ANY if (others > reading[loudest] - CEILING).any() else int(self._floor[loudest])


def _compare(device: _Sources, t: float, reading: Array, floor: int) -> None:
    """Note a scan with each phone it may be of, and which account it speaks for."""
    told, after = _explained(device, t, reading, floor)
    second = bool(told[SECOND] > told[FIRST])
    ratio = device.ratio + float(max(told[FIRST], told[SECOND]) - told[ONE]) - TURN
    device.scans += 1
    if device.labels and ratio > 0.0:
        device.ratio, device.labels = min(ratio, MOST), (*device.labels[1 - RECENT :], second)
        row = SECOND if second else FIRST
        device.put(row, t, *(part[row] for part in after))
    else:
        # Anew: what was before is the first phone, this scan is the second's.
        device.ratio, device.labels = 0.0, (True,)
        device.put(FIRST, device.t[ONE], device.level[ONE], device.variance[ONE], int(device.floor[ONE]))
        device.put(SECOND, t, *(part[NEW] for part in after))
    device.put(ONE, t, *(part[ONE] for part in after))


def _explained(
    sources: _Sources, t: float, reading: Array, floor: int
) -> tuple[Array, tuple[Array, Array, NDArray[np.int64]]]:
    """Return (4,) nats of a scan, and (4, m) level and variance and (4,) floor of who made it, after it."""
    moved = SPEED * np.abs(t - sources.t)
    drift = SPREAD**2 * (1.0 - np.exp(-moved / FAR))
    prior = np.minimum(sources.variance + drift[:, None], UNHEARD[1] ** 2)
    columns = np.flatnonzero(np.isfinite(reading))
    variance = prior[:, columns] + WHITE**2
    weight = 1.0 / variance
    error = reading[columns] - sources.level[:, columns]
    louder = (weight * error).sum(axis=1) / (DEVICE**-2 + weight.sum(axis=1))
    limit = OUTLIER * np.sqrt(variance)
    error = np.minimum(np.maximum(error - louder[:, None], -limit), limit)
    levels = (weight * error**2 + np.log(variance)).sum(axis=1)
    levels += (louder / DEVICE) ** 2 + np.log1p(DEVICE**2 * weight.sum(axis=1))
    elsewhere = (sources.floor != floor) & (sources.floor != ANY) & (np.abs(t - sources.t) < STAIRS)
    told = -FLOOR * (elsewhere & (floor != ANY)) - 0.5 * levels * min(1.0, INDEPENDENT / len(columns))
    level, after = sources.level.copy(), prior
    level[:, columns] += prior[:, columns] * weight * error
    after[:, columns] = prior[:, columns] * WHITE**2 * weight
    return told, (level, after, sources.floor if floor == ANY else np.full(4, floor))
