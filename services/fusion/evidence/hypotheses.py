"""The hypotheses "this device is carried along this track": devices in rows, tracks in columns, and their life.

Rows and columns are reused when devices and tracks are gone. A hypothesis about a new track descends from one about a
track that was lost near by, or that passes close: so a name survives a broken track.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from services.fusion.area_view import AreaView
from services.fusion.evidence.calibration import Calibration
from services.fusion.evidence.identity_settings import IdentitySettings
from services.fusion.evidence.motion_evidence import WalkFilters
from services.fusion.evidence.path_history import PathHistory
from services.fusion.evidence.radio_evidence import PathFilters
from services.fusion.snapshot import unpack

__all__ = ["Hypotheses"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

BLOCK = 8
"""Rows and columns are added in blocks."""


class Hypotheses:
    """Devices against tracks of one area, and what is known of each pair.

    Attributes:
        devices: (d,), their ids; None where a row is free.
        device_seen: (d,), when each last told what it hears.
        device_told: (d,), when each last told anything, its walk included.
        device_scans: (d,), how often it told what it hears.
        tracks: (k,), ids; 0 where a column is free.
        lost_at: (k,), when the track ended; infinity while it lives.
        place: (k, 2), where it was last.
        odds: (d, k), log-odds of "on this track" against "on none".
        probability: (d, k), marginals of the last decision.
        last_place: (d, k, 2), where each pair was at the device's scan before; NaN for none.
        given: (d,), the column each device was given, −1 for none.
        chains: (d,), ids of the tracks each device was given, oldest first.
        former: by track, the ids of the same person's earlier tracks.
        filters: what the radio says of each pair; ``strangers``: of each device carried about by a stranger, or far.
        far: (d,), log-odds of far against carried about, if on no track.
        walk_filters: what phones' walks say of each pair.
        calibration: what was learned of the access points.
        history: where the columns' tracks were in the last seconds.
    """

    def __init__(self, view: AreaView, settings: IdentitySettings | None = None) -> None:
        self.view = view
        self.settings = settings or IdentitySettings()
        self._start()

    def _start(self) -> None:
        s, points = self.settings, len(self.view.radio.names)
        self._constant_variance = np.full(points, s.noise.access_point**2)
        self.devices: list[str | None] = []
        self.device_seen = np.zeros(0)
        self.device_told = np.zeros(0)
        self.device_scans = np.zeros(0, np.int64)
        self.tracks = np.zeros(0, np.int64)
        self.lost_at = np.zeros(0)
        self.place = np.zeros((0, 2))
        self.odds = np.zeros((0, 0))
        self.probability = np.zeros((0, 0))
        self.last_place = np.zeros((0, 0, 2))
        self.given = np.zeros(0, np.int64)
        self.chains: list[list[int]] = []
        self.former: dict[int, list[int]] = {}
        self.filters = PathFilters.new(0, 0, self._constant_variance, s.noise)
        self.strangers = PathFilters.new(0, 2, self._constant_variance, s.noise)
        self.far = np.zeros(0)
        self.walk_filters = WalkFilters.new(0, 0)
        self.calibration = Calibration.of(self.view.radio)
        self.history = PathHistory()

    @property
    def alive(self) -> NDArray[np.bool_]:
        """Which columns (k,) hold a track that lives."""
        living: NDArray[np.bool_] = (self.tracks > 0) & (self.lost_at == math.inf)
        return living

    def columns(self, ids: Integers) -> Integers:
        """Return the column (n,) of each track id, all of which must be alive."""
        order = np.argsort(self.tracks, kind="stable")
        found: Integers = order[np.searchsorted(self.tracks, ids, sorter=order)]
        return found

    def follow(self, t: float, ids: Integers, places: Array) -> bool:
        """Note where the tracks are; return whether any began or ended.

        Args:
            t: the time; one before the last means that the clock was set back, and all begins anew.
            ids: (n,), the tracks that live.
            places: (n, 2), metres.
        """
        if t < self.history.newest:
            self._start()
        known = self.tracks[self.alive]
        changed = len(known) != len(ids) or not np.isin(ids, known).all()
        if changed:
            self._end(t, np.isin(self.tracks, ids))
            for index in np.flatnonzero(~np.isin(ids, self.tracks)).tolist():
                self._begin(t, int(ids[index]), places[index])
        columns = self.columns(ids)
        self.place[columns] = places
        self.history.append(t, columns, places, len(self.tracks))
        self.tracks[t - self.lost_at > self.settings.lost] = 0
        return changed

    def row(self, device: str) -> int:
        """Return the row of a device, a fresh one if it was not known."""
        if device in self.devices:
            return self.devices.index(device)
        if None not in self.devices:
            self._grow(BLOCK, 0)
        row = self.devices.index(None)
        s = self.settings
        self.devices[row] = device
        self.device_seen[row] = self.device_told[row] = -math.inf
        self.device_scans[row] = 0
        self.odds[row] = s.prior
        self.last_place[row] = np.nan
        self.filters.reset(slice(row, row + 1), slice(None), self._constant_variance, s.noise)
        self._fresh_stranger(row)
        self.walk_filters.reset_device(row)
        self.given[row] = -1
        self.chains[row] = []
        return row

    def _fresh_stranger(self, row: int) -> None:
        s = self.settings
        self.strangers.reset(slice(row, row + 1), slice(None), self._constant_variance, s.noise)
        self.strangers.cc[row, 1] += s.far_constant**2
        self.strangers.offset_variance[row, 1] += s.far_level**2
        self.far[row] = s.far_prior

    def _end(self, t: float, living: NDArray[np.bool_]) -> None:
        ended = self.alive & ~living
        self.lost_at[ended] = t
        for track in self.tracks[ended].tolist():
            self.former.pop(track, None)
        self.given[np.isin(self.given, np.flatnonzero(ended))] = -1

    def _begin(self, t: float, track: int, place: Array) -> None:
        free = np.flatnonzero(self.tracks == 0)
        if not len(free):
            self._grow(0, BLOCK)
            free = np.flatnonzero(self.tracks == 0)
        column = int(free[0])
        s = self.settings
        self.filters.reset(slice(None), slice(column, column + 1), self._constant_variance, s.noise)
        self.walk_filters.reset_track(column)
        self.last_place[:, column] = np.nan
        self.history.forget(column)
        self.odds[:, column] = s.prior
        self.probability[:, column] = 0.0
        # A hypothesis about a new track descends from one about a track lost near by, or one that passed close.
        gap = np.minimum(np.maximum(t - self.lost_at, 0.0), s.lost)
        apart = np.hypot(*(self.place - place).T)
        reach = s.swap_range**2 + (0.8 * gap) ** 2
        chance = np.where(self.lost_at == math.inf, s.swap_rate, s.continued) * np.exp(-0.5 * apart**2 / reach)
        chance[(self.tracks == 0) | (chance < 1e-3)] = 0.0
        if chance.any():
            parents = np.flatnonzero(chance)
            passed = self.odds[:, parents] + np.log(chance[parents])
            for row in range(len(self.devices)):
                best = int(np.argmax(passed[row]))
                if passed[row, best] > s.prior:
                    self.filters.inherit(row, np.array([column]), parents[[best]])
                    self.walk_filters.inherit(row, column, int(parents[best]))
                    self.last_place[row, column] = self.last_place[row, parents[best]]
                    self.odds[row, column] = np.logaddexp(s.prior, passed[row, best])
        self.tracks[column] = track
        self.lost_at[column] = math.inf
        self.place[column] = place

    def _grow(self, more_devices: int, more_tracks: int) -> None:
        s = self.settings
        devices, tracks = len(self.devices), len(self.tracks)
        d, k = devices + more_devices, tracks + more_tracks
        self.devices += [None] * more_devices
        self.chains += [[] for _ in range(more_devices)]
        self.device_seen = np.concatenate([self.device_seen, np.full(more_devices, -math.inf)])
        self.device_told = np.concatenate([self.device_told, np.full(more_devices, -math.inf)])
        self.device_scans = np.concatenate([self.device_scans, np.zeros(more_devices, np.int64)])
        self.given = np.concatenate([self.given, np.full(more_devices, -1)])
        self.far = np.concatenate([self.far, np.zeros(more_devices)])
        self.tracks = np.concatenate([self.tracks, np.zeros(more_tracks, np.int64)])
        self.lost_at = np.concatenate([self.lost_at, np.full(more_tracks, math.inf)])
        self.place = np.concatenate([self.place, np.zeros((more_tracks, 2))])
        for name, fill in (("odds", s.prior), ("probability", 0.0), ("last_place", np.nan)):
            old = getattr(self, name)
            new = np.full((d, k, *old.shape[2:]), fill)
            new[:devices, :tracks] = old
            setattr(self, name, new)
        self.filters.resize(d, k, self._constant_variance, s.noise)
        self.strangers.resize(d, 2, self._constant_variance, s.noise)
        self.walk_filters.resize(d, k)

    def state(self) -> dict[str, Any]:
        """Return a copy of all that is known; what free rows and columns hold means nothing and is left out."""
        return {
            "devices": list(self.devices),
            "chains": [list(chain) for chain in self.chains],
            "former": {str(track): list(chain) for track, chain in self.former.items()},
            "arrays": {name: getattr(self, name).copy() for name in _ARRAYS},
            "pairs": {name: array[used] for name, array, used in self._by_pair()},
            "calibration": self.calibration.state(),
            "history": self.history.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            KeyError, TypeError, ValueError: it is no such state, or one of an area with other access points; nothing
                is changed then.
        """
        fresh = Hypotheses(self.view, self.settings)
        devices = [None if device is None else str(device) for device in state["devices"]]
        arrays = {name: unpack(state["arrays"][name]) for name in _ARRAYS}
        if arrays["_constant_variance"].shape != self._constant_variance.shape:
            raise msgspec.ValidationError("the access points are not those of this site")
        fresh._grow(len(devices), len(arrays["tracks"]))
        fresh.devices = devices
        fresh.chains = [[int(track) for track in chain] for chain in state["chains"]]
        fresh.former = {int(track): [int(one) for one in chain] for track, chain in state["former"].items()}
        for name, array in arrays.items():
            setattr(fresh, name, _of_shape(getattr(fresh, name).shape, array, name))
        for name, array, used in fresh._by_pair():
            array[used] = _of_shape(array[used].shape, unpack(state["pairs"][name]), name)
        fresh.history.restore(state["history"])
        fresh.calibration.restore(state["calibration"])
        for name in _ALL:
            setattr(self, name, getattr(fresh, name))

    def _by_pair(self) -> Iterator[tuple[str, Array, Any]]:
        """Yield name, array and which part is in use of all that is kept by device and hypothesis."""
        rows = np.array([row for row, device in enumerate(self.devices) if device is not None], np.int64)
        pairs = np.ix_(rows, np.flatnonzero(self.tracks > 0))
        for name in ("odds", "probability", "last_place"):
            yield name, getattr(self, name), pairs
        for field in fields(PathFilters):
            yield f"filters.{field.name}", getattr(self.filters, field.name), pairs
            yield f"strangers.{field.name}", getattr(self.strangers, field.name), rows
        for field in fields(WalkFilters):
            used = rows if field.name == "last" else pairs
            yield f"walk_filters.{field.name}", getattr(self.walk_filters, field.name), used


def _of_shape(expected: tuple[int, ...], array: NDArray[Any], name: str) -> NDArray[Any]:
    if array.shape != expected:
        raise msgspec.ValidationError(f"{name}: shape {array.shape}, expected {expected}")
    return array


_ARRAYS = (
    "_constant_variance",
    "device_seen",
    "device_told",
    "device_scans",
    "tracks",
    "lost_at",
    "place",
    "given",
    "far",
)
"""Kept by device, by track or by access point."""
_ALL = (
    *_ARRAYS,
    *("odds", "probability", "last_place", "filters", "strangers", "walk_filters"),
    *("devices", "chains", "former", "calibration", "history"),
)
