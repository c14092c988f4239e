"""What earlier stretches tell of access points and phones: which reads by how much beyond the active model.

Without it a stretch could be judged by how its readings change alone, since an untrained model is off by several dB.
One Gaussian number per access point and per phone, each learned from what the others leave, with slow forgetting; and
what each access point's readings are like wherever they are made. Bounded: the phones heard last are kept.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.learning.tracks.radio_evidence import Fit, RadioBelief
from shared.radio import Nowhere

__all__ = ["RadioHabits"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

POINT, MAPPED, DEVICE = 6.0, 2.0, 3.0
"""dB beforehand: an access point about a plain model, about one with a learned map, a phone about the others."""
DRIFT = 0.3
"""dB per stretch by which an access point may change."""
DEVICES = 500
"""Phones remembered."""
STRETCHES = 100.0
"""Stretches after which what readings are like is 1/e forgotten."""
UNKNOWN = (-75.0, 12.0)
"""dBm and dB, of the readings of an access point never heard."""


class RadioHabits:
    """What m access points and the phones heard last are like.

    Args:
        points: m.
    """

    def __init__(self, points: int) -> None:
        self._points = points
        self._weight, self._sum, self._squares = np.zeros(points), np.zeros(points), np.zeros(points)
        self._devices: OrderedDict[str, tuple[float, float]] = OrderedDict()
        self._spread = POINT
        self.begin_anew(mapped=False)

    def begin_anew(self, *, mapped: bool) -> None:
        """Forget how access points and phones differ from the model: it is another one, ``mapped`` one with a map."""
        self._spread = MAPPED if mapped else POINT
        self._bias, self._variance = np.zeros(self._points), np.full(self._points, self._spread**2)
        self._devices.clear()

    def belief(self, device: str) -> RadioBelief:
        """Return what is known before a stretch of this phone."""
        offset, variance = self._devices.get(device, (0.0, DEVICE**2))
        count = self._weight + 1.0
        mean = (self._sum + UNKNOWN[0]) / count
        square = (self._squares + UNKNOWN[0] ** 2 + UNKNOWN[1] ** 2) / count
        # Taken whole, phones' own offsets and quick noise among it: without these quality followed errors less.
        nowhere = Nowhere.of(mean, square - mean**2)
        return RadioBelief(self._bias, self._variance, offset, variance, nowhere)

    def hear(self, point: Integers, level: Array) -> None:
        """Take in the readings (r,) of a stretch, wherever it was: each access point's count as one, together."""
        count = np.bincount(point, minlength=self._points)
        heard = count > 0
        kept = np.where(heard, 1.0 - 1.0 / STRETCHES, 1.0)
        share = np.where(heard, 1.0 / np.maximum(count, 1), 0.0)
        self._weight = kept * self._weight + heard
        self._sum = kept * self._sum + share * np.bincount(point, level, self._points)
        self._squares = kept * self._squares + share * np.bincount(point, level**2, self._points)

    def learn(self, device: str, fit: Fit) -> None:
        """Take in by how much a good stretch's readings differed from model and belief."""
        heard = np.isfinite(fit.offset[0])
        if not heard.any():
            return
        beyond, variance = fit.offset[0, heard], fit.offset_variance[heard]
        offset, spread = self._devices.pop(device, (0.0, DEVICE**2))
        weight = 1.0 / (variance + self._variance[heard])
        known = 1.0 / (1.0 / spread + weight.sum())
        offset = known * (offset / spread + float(weight @ beyond))
        self._devices[device] = (offset, known)
        while len(self._devices) > DEVICES:
            self._devices.popitem(last=False)
        gain = self._variance[heard] / (self._variance[heard] + variance + known)
        self._bias[heard] += gain * (beyond - offset)
        self._variance[heard] = np.minimum((1.0 - gain) * self._variance[heard] + DRIFT**2, self._spread**2)

    def forget(self, device: str) -> None:
        """Forget a phone."""
        self._devices.pop(device, None)

    def state(self) -> dict[str, Any]:
        """Return all it knows."""
        return {
            "bias": self._bias.tolist(),
            "variance": self._variance.tolist(),
            "spread": self._spread,
            "devices": [[name, *known] for name, known in self._devices.items()],
            "heard": [self._weight.tolist(), self._sum.tolist(), self._squares.tolist()],
        }

    def restore(self, state: Mapping[str, Any], columns: Integers | None = None) -> None:
        """Go on from ``state()``.

        Args:
            state: see there.
            columns: (k,) which access point here each of the k of the state is; −1: none; None: they are the same.

        Raises:
            KeyError, TypeError, ValueError: it is no such state, or of other access points.
        """
        if columns is None:
            columns = np.arange(self._points)
        saved = [np.array(column, float) for column in (state["bias"], state["variance"], *state["heard"])]
        if len(saved) != 5 or any(column.shape != columns.shape for column in saved):
            raise ValueError(f"a state of other access points; allowed: of {len(columns)}")
        devices = OrderedDict((str(name), (float(offset), float(spread))) for name, offset, spread in state["devices"])
        self._spread = float(state["spread"])
        fresh = [np.full(self._points, value) for value in (0.0, self._spread**2, 0.0, 0.0, 0.0)]
        for here, known in zip(fresh, saved, strict=True):
            here[columns[columns >= 0]] = known[columns >= 0]
        self._bias, self._variance, self._weight, self._sum, self._squares = fresh
        self._devices = devices
