"""What each phone of an area taught, row by row, and which model of it is in use: what lessons of walking remember."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Generic, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from shared.messages import HeadingModel, StrideModel

__all__ = ["DeviceRows"]

Array = NDArray[np.float64]
M = TypeVar("M", StrideModel, HeadingModel)

MOST_DEVICES = 1000
T = 0
"""The column of every row that holds its time."""


class _Device(msgspec.Struct, Generic[M]):
    rows: list[list[float]]
    model: M | None = None


class DeviceRows(Generic[M]):
    """Rows and models by device.

    Args:
        name: of the lessons, for errors.
        columns: of a row; the first is its time, seconds.
        most: rows kept of a device: the latest.
        model: of what kind the models are.
    """

    def __init__(self, name: str, columns: int, most: int, model: type[M]) -> None:
        self._name = name
        self._columns = columns
        self._most = most
        self._model: type[M] = model
        self._rows: dict[str, Array] = {}
        self._models: dict[str, M] = {}
        self._looked_at: dict[str, tuple[float, int]] = {}
        """By device, the time of its newest row when it was last looked at, and how many rows might teach."""

    def rows(self, device: str) -> Array:
        """Return what a device taught (n, columns); n is 0 of one that taught nothing."""
        return self._rows.get(device, np.empty((0, self._columns)))

    def model(self, device: str) -> M | None:
        """Return a device's model in use."""
        return self._models.get(device)

    def keep(self, device: str, rows: Array) -> None:
        """Keep the latest of a device's rows (n, columns); of too many devices who taught longest ago is forgotten."""
        self._rows.pop(device, None)
        self._rows[device] = rows[-self._most :]
        if len(self._rows) > MOST_DEVICES:
            self.forget(next(iter(self._rows)))

    def activated(self, model: M) -> None:
        """Know the model in use; its device is to be looked at anew."""
        self._models[model.device] = model
        self._looked_at.pop(model.device, None)

    def forget(self, device: str) -> None:
        """Forget a device."""
        for kept in (self._rows, self._models, self._looked_at):
            kept.pop(device, None)

    def news(self, until: float) -> Iterator[tuple[str, Array]]:
        """Yield devices and rows about which there is more to say than at the last look.

        Args:
            until: seconds; what is newer may not teach.
        """
        for device, rows in self._rows.items():
            known = (float(rows[-1, T]), int((rows[:, T] <= until).sum()))
            if self._looked_at.get(device) != known:
                self._looked_at[device] = known
                yield device, rows

    @property
    def devices(self) -> list[str]:
        """Of whom something is known."""
        return sorted(self._rows.keys() | self._models.keys())

    def state(self) -> dict[str, Any]:
        """Return rows and models in use, by device."""
        state: dict[str, Any] = msgspec.to_builtins(
            {device: _Device(self.rows(device).tolist(), self.model(device)) for device in self.devices}
        )
        return state

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            ValueError: it is none; nothing is changed.
        """
        try:
            known = msgspec.convert(state, dict[str, _Device[self._model]])  # type: ignore[name-defined]
        except msgspec.ValidationError as error:
            raise ValueError(f"{self._name}: devices: {error}") from error
        for device, kept in known.items():
            if any(len(row) != self._columns for row in kept.rows):
                raise ValueError(f"{self._name}: devices.{device}.rows: allowed: {self._columns} numbers in each")
        self._rows = {device: np.array(kept.rows, float) for device, kept in known.items() if kept.rows}
        self._models = {device: kept.model for device, kept in known.items() if kept.model is not None}
        self._looked_at = {}
