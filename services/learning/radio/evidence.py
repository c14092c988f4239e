"""What is kept of good stretches: a phone's visits to spots, bounded in number, with times so that they can fade.

Nobody's path is kept for long: of each spot the newest few visits stay, whoever paid them, and a device that is erased
takes its visits along.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.learning.tracks.stretch import Stretch
from shared.radio import RadioPrior, Visits, gather_visits, novelty
from shared.radio.radio_fit import SPOT

__all__ = ["RadioEvidence"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST = 48_000
"""Visits kept; when there are more, of each spot the oldest go first."""
NEWEST = 16
"""Of a spot and access point, to begin with."""
FEWEST = 4
"""Scans of a stretch; fewer teach nothing, because too often the name was a guess."""
DOUBTFUL = 0.4
"""How much a visit counts whose name is in doubt. Stretches are sure where the radio is as expected already: those
alone would draw the map least where it is needed most. Of the others two thirds are right, and what is far off counts
for little anyhow."""
QUIET = 600.0
"""Seconds: a night or a day without anybody ages evidence by no more, for it is the world that ages it."""
COLUMNS = ("t", "age", "device", "point", "x", "y", "level", "weight", "kept")


class RadioEvidence:
    """Visits of one area.

    Args:
        points: how many access points there are.
        prior: says how much a reading at a place known so well is worth.

    Attributes:
        devices: the phones, in the order of their numbers.
        renumbered: how often these numbers changed.
    """

    def __init__(self, points: int, prior: RadioPrior) -> None:
        self._points, self._prior = points, prior
        self.devices: list[str] = []
        self.renumbered = 0
        self._rows: Array = np.empty((0, len(COLUMNS)))
        self._clock, self._newest = 0.0, -np.inf

    def __len__(self) -> int:
        """How many visits are kept."""
        return len(self._rows)

    def take(self, stretch: Stretch, *, doubtful: bool = False) -> Visits:
        """Take in a stretch; returns its visits, phones numbered as in ``devices``."""
        known = (stretch.point >= 0) & (stretch.point < self._points)
        times, first, scan = np.unique(stretch.scan_t, return_index=True, return_inverse=True)
        share = novelty(stretch.scan_place[first]) * np.interp(times, stretch.t, stretch.probability)
        weight = share[scan.ravel()] / self._prior.noise(stretch.scan_spread)
        if len(times) < FEWEST:
            known[:] = False
        if stretch.device not in self.devices:
            if not known.any():
                return _visits(np.empty((0, len(COLUMNS))))
            self.devices.append(stretch.device)
        device = np.full(int(known.sum()), self.devices.index(stretch.device), np.int64)
        visits = gather_visits(
            stretch.scan_t[known], device, np.zeros(len(device), np.int64), stretch.point[known],
            stretch.scan_place[known], stretch.level[known], weight[known],
        )  # fmt: skip
        age = np.array([self._aged(t) for t in visits.t.tolist()])
        columns = (visits.t, age, visits.device, visits.point, *visits.place.T, visits.level, visits.weight)
        self._rows = np.concatenate(
            [self._rows, np.column_stack([*columns, np.full(len(visits), DOUBTFUL if doubtful else 1.0)])]
        )
        if len(self._rows) > MOST:
            self._thin()
        return visits

    def visits(
        self, since: float = -np.inf, until: float = np.inf, *, sure: bool = False
    ) -> tuple[Visits, Array, Array]:
        """Return the visits after ``since`` and up to ``until``, how old each is in seconds, and (n,) 0 to 1 how much
        it counts: less where its name was in doubt, and after what changed; ``sure``: without those in doubt.
        """
        during = (self._rows[:, 0] > since) & (self._rows[:, 0] <= until)
        rows = self._rows[during & (self._rows[:, 8] > DOUBTFUL) if sure else during]
        newest = float(rows[:, 1].max(initial=0.0))
        return _visits(rows), newest - rows[:, 1], rows[:, 8]

    def count(self, point: int) -> int:
        """Return how many visits of an access point are kept whose name is not in doubt."""
        return int(((self._rows[:, 3] == point) & (self._rows[:, 8] > DOUBTFUL)).sum())

    def fade(self, point: int, before: float, kept: float, near: Array | None = None, reach: float = 0.0) -> None:
        """Let an access point's visits from before a change count less.

        Args:
            point: which.
            before: when it changed, seconds.
            kept: 0 to 1.
            near: (k, 2) only visits within ``reach`` metres of one of these places; None: all.
            reach: see above.
        """
        hit = self._of(point, before)
        if near is not None:
            away = np.hypot(*(self._rows[:, None, 4:6] - near[None]).transpose(2, 0, 1)).min(axis=1, initial=np.inf)
            hit &= away <= reach
        self._rows[hit, 8] *= kept

    def shift(self, point: int, before: float, by: float) -> None:
        """Let an access point's visits from before a change read ``by`` dB more: it sends otherwise now."""
        self._rows[self._of(point, before), 6] += by

    def forget(self, device: str) -> None:
        """Forget a device."""
        if device in self.devices:
            number = self.devices.index(device)
            self._rows = self._rows[self._rows[:, 2] != number]
            self._rows[self._rows[:, 2] > number, 2] -= 1
            del self.devices[number]
            self.renumbered += 1

    def state(self) -> dict[str, Any]:
        """Return all it knows."""
        return {
            "devices": list(self.devices),
            "rows": base64.b64encode(self._rows.astype("<f8").tobytes()).decode(),
            "clock": [self._clock, None if np.isinf(self._newest) else self._newest],
        }

    def restore(self, state: Mapping[str, Any], columns: Index) -> None:
        """Go on from ``state()``.

        Args:
            state: see there.
            columns: (k,) which access point here each of the k of the state is; visits of −1 go.

        Raises:
            ValueError: it is no such state; nothing is changed then.
        """
        try:
            rows = np.frombuffer(base64.b64decode(state["rows"]), "<f8").reshape(-1, len(COLUMNS)).copy()
            devices = [str(device) for device in state["devices"]]
            clock, newest = state["clock"]
            clock, newest = float(clock), -np.inf if newest is None else float(newest)
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"radio evidence: {error}") from error
        numbers = rows[:, 2:4]
        if not np.isfinite(rows).all() or (numbers < 0).any() or (numbers >= (len(devices), len(columns))).any():
            raise ValueError(f"radio evidence: a row is not of {len(devices)} devices and {len(columns)} access points")
        rows[:, 3] = columns[rows[:, 3].astype(np.int64)]
        self.devices, self._clock, self._newest = devices, clock, newest
        self._rows = rows[rows[:, 3] >= 0]
        if len(self._rows) < len(rows):
            self._let_devices_go()

    def _of(self, point: int, before: float) -> NDArray[np.bool_]:
        hit: NDArray[np.bool_] = (self._rows[:, 3] == point) & (self._rows[:, 0] < before)
        return hit

    def _aged(self, t: float) -> float:
        """Return the time on a clock that stands still while nobody is about."""
        if t > self._newest:
            self._clock += 0.0 if np.isinf(self._newest) else min(t - self._newest, QUIET)
            self._newest = t
            return self._clock
        return self._clock - min(self._newest - t, QUIET)

    def _thin(self) -> None:
        spots = np.column_stack([self._rows[:, 3], np.floor(self._rows[:, 4:6] / SPOT)])
        _, spot = np.unique(spots, axis=0, return_inverse=True)
        spot = spot.ravel()
        order = np.lexsort((-self._rows[:, 0], spot))
        begins = np.r_[True, np.diff(spot[order]) != 0]
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order)) - np.maximum.accumulate(np.where(begins, np.arange(len(order)), 0))
        newest = NEWEST
        while newest > 1 and int((rank < newest).sum()) > 0.75 * MOST:
            newest //= 2
        self._rows = self._rows[rank < newest]
        if len(self._rows) > MOST:
            self._rows = self._rows[np.sort(np.argsort(-self._rows[:, 0], kind="stable")[: int(0.75 * MOST)])]
        self._let_devices_go()

    def _let_devices_go(self) -> None:
        """Forget the names of phones of which no visit is left."""
        there = np.unique(self._rows[:, 2].astype(np.int64))
        self._rows[:, 2] = np.searchsorted(there, self._rows[:, 2])
        self.devices = [self.devices[number] for number in there.tolist()]
        self.renumbered += 1


def _visits(rows: Array) -> Visits:
    return Visits(
        rows[:, 0], rows[:, 2].astype(np.int64), rows[:, 3].astype(np.int64), rows[:, 4:6], rows[:, 6], rows[:, 7]
    )
