"""What is known of every device of one area, row by row, and how devices and tracks come and go."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from services.fusion.area_view import AreaView
from services.fusion.evidence.belief import Beliefs
from services.fusion.evidence.calibration import Calibration
from services.fusion.evidence.floor_grid import FloorGrid
from services.fusion.evidence.hearing import Hearing
from services.fusion.evidence.identity_settings import IdentitySettings
from services.fusion.snapshot import counts, of_shape, unpack
from services.fusion.trained_view import same_radio
from services.fusion.walks.columns import Columns
from services.fusion.walks.motion_evidence import WalkFilters
from shared.messages import MotionBatch, RadioScan, decode

__all__ = ["Devices"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

BLOCK = 8
"""Rows are added in blocks."""


class Devices:
    """All devices of one area.

    Attributes:
        devices: (d,), ids; None where a row is free.
        told: (d,), when each last told anything; ``scans``: (d,), how often what it hears.
        walking: (d,), share of the last second in which it walked, 0 or 1; ``walked_until``: (d,), up to when it told
            of its walk; ``stepped``: (d,), when its last step ended.
        hearing: by row, what it hears and how it is heard.
        given: (d,), the column each device was given, −1 for none.
        probability: (d, k), marginals of the last decision.
        chains: by row, ids of the tracks each device was given, oldest first.
        former: by track, the ids of the same person's earlier tracks.
        estimates: by row, of devices on no track: where they are likely to be, see ``estimates``.
    """

    def __init__(self, view: AreaView, settings: IdentitySettings | None = None) -> None:
        self.view = view
        self.settings = settings or IdentitySettings()
        self.grid = FloorGrid(view)
        self.ignored: Counter[str] = Counter()
        self._start()

    def _tune(self, view: AreaView) -> None:
        self.view = view
        placed = view.radio.placed.tolist()
        self._column_of_point = {name: index for index, name in enumerate(view.radio.names) if placed[index]}
        self._distance = view.radio.log_distance(self.grid.centres)
        self._map = None if view.shadowing is None else view.shadowing.at(self.grid.centres)
        self.calibration = Calibration.of(view.radio, learned=view.shadowing is not None)
        self._expected = self.calibration.rssi_at(self._distance)

    def _start(self) -> None:
        s = self.settings
        self.columns = Columns(s.kept)
        self.beliefs = Beliefs(self.grid, s.flow)
        self.walk_filters = WalkFilters.new(0, 0)
        self._tune(self.view)
        self.devices: list[str | None] = []
        self.told = np.zeros(0)
        self.scans = np.zeros(0, np.int64)
        self.walking = np.zeros(0)
        self.walked_until = np.zeros(0)
        self.stepped = np.zeros(0)
        self.hearing: list[tuple[Hearing, Hearing]] = []
        self.given = np.zeros(0, np.int64)
        self.probability = np.zeros((0, 0))
        self.chains: list[list[int]] = []
        self.former: dict[int, list[int]] = {}
        self.estimates: dict[int, tuple[Array, Array, float]] = {}
        self._scans: list[RadioScan] = []
        self._motions: list[MotionBatch] = []
        self._decided = self._calibrated = -math.inf
        self._dirty = False

    def retune(self, view: AreaView) -> None:
        """Go on under another radio model: who is where stays as believed.

        What access points were learned to send is forgotten, for the new model may have been taught by the same
        readings. What a device reads too much is so much less, as far as it was learned, as the new model expects more.
        """
        if same_radio(self.view, view):
            return
        before, compared = self._heard_on_grid(), self.view.radio.placed & view.radio.placed
        self._tune(view)
        more = float((self._heard_on_grid() - before)[:, compared].mean()) if compared.any() else 0.0
        for row in self.rows.tolist():
            for ear, fresh in zip(self.hearing[row], self._fresh_ears(), strict=True):
                ear.offset -= (1.0 - ear.variance / fresh.variance) * more

    def _heard_on_grid(self) -> Array:
        """Return what is expected to be heard on the floor, (cells, m) in dBm."""
        return self._expected if self._map is None else self._expected + self._map[0]

    @property
    def rows(self) -> Integers:
        """Rows in use."""
        return np.array([row for row, device in enumerate(self.devices) if device is not None], np.int64)

    def _follow(self, t: float, ids: Integers, places: Array, coasting: NDArray[np.bool_]) -> None:
        before = len(self.columns.tracks)
        ended, began = self.columns.follow(t, ids, places, coasting)
        if len(self.columns.tracks) > before:
            self._resize(len(self.devices), len(self.columns.tracks))
        rows = self.rows
        for column in ended.tolist():
            self.beliefs.end(column, self.columns.place[column], rows)
            self.former.pop(int(self.columns.tracks[column]), None)
            self.given[self.given == column] = -1
        for column in began.tolist():
            self.probability[:, column] = 0.0
            self.walk_filters.reset_track(column)
            self.beliefs.begin(column, self.columns.place[column], rows, len(self.columns.alive))
            parents = self.given[rows]
            held = parents >= 0
            self.walk_filters.inherit(rows[held], column, parents[held])
        self._dirty |= bool(len(ended) or len(began))

    def row(self, device: str) -> int:
        """Return the row of a device, a fresh one if it was not known."""
        if device in self.devices:
            return self.devices.index(device)
        if None not in self.devices:
            self._resize(len(self.devices) + BLOCK, len(self.columns.tracks))
        row = self.devices.index(None)
        self.devices[row] = device
        self.beliefs.open(row, self.columns.alive)
        return row

    def _forget(self, row: int) -> None:
        """Free a row; it is as if nobody had ever had it."""
        self.devices[row] = None
        self.estimates.pop(row, None)
        self.told[row], self.scans[row], self.given[row] = -math.inf, 0, -1
        self.walking[row], self.walked_until[row], self.stepped[row] = 0.0, -math.inf, -math.inf
        self.hearing[row] = self._fresh_ears()
        self.chains[row] = []
        self.probability[row] = 0.0
        self.walk_filters.reset_device(row)
        self.beliefs.forget(row)

    def _fresh_ears(self) -> tuple[Hearing, Hearing]:
        return Hearing(0.0, self.settings.device**2), Hearing(0.0, self.settings.device_sent**2)

    def _resize(self, devices: int, tracks: int) -> None:
        more = devices - len(self.devices)
        self.devices += [None] * more
        self.chains += [[] for _ in range(more)]
        self.hearing += [self._fresh_ears() for _ in range(more)]
        self.told = np.concatenate([self.told, np.full(more, -math.inf)])
        self.scans = np.concatenate([self.scans, np.zeros(more, np.int64)])
        self.walking = np.concatenate([self.walking, np.zeros(more)])
        self.walked_until = np.concatenate([self.walked_until, np.full(more, -math.inf)])
        self.stepped = np.concatenate([self.stepped, np.full(more, -math.inf)])
        self.given = np.concatenate([self.given, np.full(more, -1)])
        probability = np.zeros((devices, tracks))
        probability[: self.probability.shape[0], : self.probability.shape[1]] = self.probability
        self.probability = probability
        self.beliefs.resize(devices, tracks)
        self.walk_filters.resize(devices, tracks)

    def state(self) -> dict[str, Any]:
        """Return a copy of all that is known; what free rows and columns hold means nothing and is left out."""
        rows, taken = self.rows, np.flatnonzero(self.columns.tracks > 0)
        return {
            "devices": list(self.devices),
            "chains": [list(chain) for chain in self.chains],
            "former": {str(track): list(chain) for track, chain in self.former.items()},
            "arrays": {name: getattr(self, name).copy() for name in _ARRAYS},
            "probability": self.probability[np.ix_(rows, taken)],
            "hearing": [[ear.state() for ear in self.hearing[row]] for row in rows.tolist()],
            "beliefs": self.beliefs.state(rows, taken),
            "walks": self.walk_filters.state(rows, taken),
            "columns": self.columns.state(),
            "calibration": self.calibration.state(),
            "scans": list(self._scans),
            "motions": list(self._motions),
            "decided": self._decided if math.isfinite(self._decided) else None,
            "calibrated": self._calibrated if math.isfinite(self._calibrated) else None,
            "estimates": [
                [row, np.concatenate([place, covariance.ravel(), [probability]])]
                for row, (place, covariance, probability) in self.estimates.items()
            ],
            "dirty": self._dirty,
            "ignored": dict(self.ignored),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            KeyError, TypeError, ValueError: it is no such state, or one of an area with other access points; the layer
                is then good for nothing.
        """
        self._start()
        self.columns.restore(state["columns"])
        devices = [None if device is None else str(device) for device in state["devices"]]
        self._resize(len(devices), len(self.columns.tracks))
        self.devices = devices
        self.chains = [[int(track) for track in chain] for chain in state["chains"]]
        self.former = {int(track): [int(one) for one in chain] for track, chain in state["former"].items()}
        for name in _ARRAYS:
            setattr(self, name, of_shape(unpack(state["arrays"][name]), getattr(self, name).shape))
        rows, taken = self.rows, np.flatnonzero(self.columns.tracks > 0)
        self.probability = np.zeros((len(devices), len(self.columns.tracks)))
        self.probability[np.ix_(rows, taken)] = unpack(state["probability"])
        for row, ears in zip(rows.tolist(), state["hearing"], strict=True):
            first, second = (Hearing.restored(ear) for ear in ears)
            self.hearing[row] = (first, second)
        self.beliefs.restore(state["beliefs"], rows, taken)
        self.walk_filters.restore(state["walks"], rows, taken)
        self.calibration.restore(state["calibration"])
        self._expected = self.calibration.rssi_at(self._distance)
        self._scans = [decode(msgspec.json.encode(scan), RadioScan) for scan in state["scans"]]
        self._motions = [decode(msgspec.json.encode(batch), MotionBatch) for batch in state["motions"]]
        self._decided, self._calibrated = (
            -math.inf if state[name] is None else float(state[name]) for name in ("decided", "calibrated")
        )
        for row, packed in state["estimates"]:
            numbers = of_shape(unpack(packed), (7,))
            self.estimates[int(row)] = (numbers[:2], numbers[2:6].reshape(2, 2), float(numbers[6]))
        self._dirty, self.ignored = bool(state["dirty"]), counts(state["ignored"])


_ARRAYS = ("told", "scans", "walking", "walked_until", "stepped", "given")
"""Kept by row."""
