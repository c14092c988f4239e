"""How likely are these signal strengths along this path? One Gaussian with every correlation written out.

Slow and plain on purpose: the incremental filters of the services are held against it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["RadioNoise", "log_likelihood"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RadioNoise:
    """Why a reading differs from the path-loss model; standard deviations in dB.

    Attributes:
        white: from one reading to the next (fading, whole-dBm rounding).
        shadowing: of the place (bodies, walls); its correlation is exp(−distance / ``shadowing_range``).
        shadowing_range: metres.
        access_point: of the access point's constants, the same in all of a device's readings of it.
        device: of the device's antenna, the same in all readings of a device.
    """

    white: float = 2.2
    shadowing: float = 4.0
    shadowing_range: float = 3.0
    access_point: float = 3.0
    device: float = 3.0


def log_likelihood(residual: Array, places: Array, access_point: NDArray[np.int64], noise: RadioNoise) -> float:
    """Return log N(residual; 0, C) of one device's readings, all noise sources marginalised.

    Args:
        residual: (n,), heard minus expected, dB.
        places: (n, 2), where the device was at each reading, metres.
        access_point: (n,), which access point each reading is of.
        noise: the sizes of the noise sources.
    """
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    same = access_point[:, None] == access_point[None]
    covariance = noise.device**2 + same * (
        noise.access_point**2 + noise.shadowing**2 * np.exp(-apart / noise.shadowing_range)
    )
    covariance = covariance + noise.white**2 * np.eye(len(residual))
    lower = np.linalg.cholesky(covariance)
    whitened = np.linalg.solve(lower, residual)
    half_log_det = float(np.log(np.diag(lower)).sum())
    return -0.5 * float(whitened @ whitened) - half_log_det - 0.5 * len(residual) * math.log(2.0 * math.pi)
