"""What a phone heard in a cycle: one signal strength per access point, however many scans there were.

Ten scans in a second are not ten independent ones: bodies and walls have not moved between them. They are averaged, and
count as one. Scans in which fixed receivers heard the phone err by an offset of their own, which is learned.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.fusion.rbmcda.settings import RbmcdaSettings
from shared.messages import RadioScan
from shared.radio import PathLoss

__all__ = ["Readings"]

Array = NDArray[np.float64]

WEAKEST, STRONGEST = -120.0, 0.0
LEARNING = 0.1
"""Share by which the offset of fixed receivers follows each cycle."""


class Readings:
    """Scans held until their cycle; what is heard of access points that nobody has placed is passed over."""

    def __init__(self, radio: PathLoss, settings: RbmcdaSettings) -> None:
        self._points = len(radio.names)
        self._column = _columns(radio)
        self._settings = settings
        self._waiting: dict[str, list[Array]] = {}
        self._by_site: dict[str, list[Array]] = {}
        self._offset: dict[str, float] = {}
        self._last_by_site: dict[str, Array] = {}

    def take(self, scan: RadioScan) -> bool:
        """Note a scan; False if none of its access points is known."""
        level = np.full(self._points, np.nan)
        for name, rssi in zip(scan.access_point, scan.rssi, strict=True):
            index = self._column.get(name)
            if index is not None and WEAKEST <= rssi <= STRONGEST:
                level[index] = rssi
        if not np.isfinite(level).any():
            return False
        held = self._by_site if scan.heard_by_site else self._waiting
        held.setdefault(scan.device, []).append(level)
        return True

    def of_cycle(self, known: Iterable[str]) -> tuple[dict[str, Array], dict[str, Array]]:
        """Return and forget the levels (M,) in dBm, NaN for not heard, and noise (M,) in dB², by device."""
        reading: dict[str, Array] = {}
        noise: dict[str, Array] = {}
        self._last_by_site = {}
        for device in sorted(set(known)):
            scans = self._waiting.get(device)
            if scans is None and device in self._by_site:
                scans = self._by_site[device]
                level = _mean(scans)
                self._last_by_site[device] = level
                reading[device] = level - self._offset.get(device, 0.0)
            elif scans is not None:
                reading[device] = _mean(scans)
            else:
                continue
            noise[device] = np.full(self._points, self._settings.noise.white**2)
        self._waiting, self._by_site = {}, {}
        return reading, noise

    def learn(self, devices: Sequence[str], places: Array, expected: Callable[[Array], Array]) -> None:
        """Let the offsets of fixed receivers follow what they heard of devices that are at (X, 2) ``places``."""
        for index, device in enumerate(devices):
            level = self._last_by_site.get(device)
            if level is None:
                continue
            wrong = float(np.nanmean(level - expected(places[index : index + 1])[0]))
            before = self._offset.get(device)
            self._offset[device] = wrong if before is None else before + LEARNING * (wrong - before)

    def retune(self, radio: PathLoss, less: float) -> None:
        """Note another radio, and that so many dB less are expected: what receivers read too much is so much more."""
        self._column = _columns(radio)
        self._offset = {device: offset + less for device, offset in self._offset.items()}

    def forget(self, device: str) -> None:
        """Forget a device."""
        for held in (self._waiting, self._by_site, self._offset, self._last_by_site):
            held.pop(device, None)

    def state(self) -> dict[str, Any]:
        """Return what is held, as plain values."""
        return {
            "waiting": {device: _plain(scans) for device, scans in self._waiting.items()},
            "by_site": {device: _plain(scans) for device, scans in self._by_site.items()},
            "offset": dict(self._offset),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state()``."""
        self._waiting = {device: _arrays(scans) for device, scans in state["waiting"].items()}
        self._by_site = {device: _arrays(scans) for device, scans in state["by_site"].items()}
        self._offset = {str(device): float(offset) for device, offset in state["offset"].items()}


def _columns(radio: PathLoss) -> dict[str, int]:
    """Return which columns access points have that are placed."""
    return {name: index for index, name in enumerate(radio.names) if radio.placed[index]}


def _mean(scans: Sequence[Array]) -> Array:
    """Return the mean level (M,), NaN where never heard."""
    levels = np.stack(scans)
    heard = np.isfinite(levels)
    count = heard.sum(axis=0).astype(np.float64)
    total = np.where(heard, levels, 0.0).sum(axis=0)
    return np.where(count > 0.0, total / np.maximum(count, 1.0), np.nan)


def _plain(scans: Sequence[Array]) -> list[list[float | None]]:
    return [[value if math.isfinite(value) else None for value in scan.tolist()] for scan in scans]


def _arrays(scans: Sequence[Sequence[float | None]]) -> list[Array]:
    return [np.array([math.nan if value is None else value for value in scan]) for scan in scans]
