"""How strong should each access point be heard at this place? Log-distance path loss."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.site import AccessPoint

__all__ = ["DEVICE_HEIGHT", "PathLoss"]

Array = NDArray[np.float64]

DEVICE_HEIGHT = 1.1
"""Metres above the floor at which a phone is carried."""

NEAREST = 0.3
"""Metres; the model diverges at the access point itself [ravel-thesis §3.3]."""

UNPLACED = 10.0
"""10 log₁₀ of the distance from anywhere to an access point that nobody has placed: what is heard of it speaks for no
place."""


@dataclass(frozen=True)
class PathLoss:
    """RSS(x) = P₀ − 10 n log₁₀ |A − x|, one P₀ and n per access point [ravel-thesis §3.3, Eq. 4.5].

    Attributes:
        names: site ids of the m access points.
        positions: (m, 3), metres; NaN where nobody knows.
        power_1m: (m,), P₀ in dBm.
        exponent: (m,), n.
    """

    names: tuple[str, ...]
    positions: Array
    power_1m: Array
    exponent: Array

    @classmethod
    def of(cls, access_points: Sequence[AccessPoint]) -> PathLoss:
        """Return the model the site file describes."""
        return cls(
            names=tuple(point.id for point in access_points),
            positions=np.array([point.position or (np.nan,) * 3 for point in access_points], float).reshape(-1, 3),
            power_1m=np.array([point.power_1m for point in access_points], float),
            exponent=np.array([point.path_loss_exponent for point in access_points], float),
        )

    @property
    def placed(self) -> NDArray[np.bool_]:
        """(m,) of which access points it is known where they hang; what is heard of the others is to be passed over."""
        placed: NDArray[np.bool_] = np.asarray(np.isfinite(self.positions).all(axis=1))
        return placed

    def log_distance(self, places: Array) -> Array:
        """Return 10 log₁₀ of the distance, (n, m), from each of (n, 2) places at phone height to each access point."""
        squared = (places[:, 0, None] - self.positions[:, 0]) ** 2
        squared += (places[:, 1, None] - self.positions[:, 1]) ** 2
        squared += (self.positions[:, 2] - DEVICE_HEIGHT) ** 2
        return _log_distance(squared, self.placed)

    def rssi(self, places: Array) -> Array:
        """Return the expected signal strengths, (n, m) in dBm, at (n, 2) places."""
        return self.power_1m - self.exponent * self.log_distance(places)

    def rssi_of(self, places: Array, access_point: NDArray[np.int64]) -> Array:
        """Return (…, n) dBm expected at (…, n, 2) places of one access point each, (n,)."""
        anchor = self.positions[access_point]
        squared = ((places - anchor[:, :2]) ** 2).sum(axis=-1) + (anchor[:, 2] - DEVICE_HEIGHT) ** 2
        return self.power_1m[access_point] - self.exponent[access_point] * _log_distance(
            squared, self.placed[access_point]
        )


def _log_distance(squared: Array, placed: NDArray[np.bool_]) -> Array:
    level: Array = np.where(placed, 5.0 * np.log10(np.maximum(squared, NEAREST**2)), UNPLACED)
    return level
