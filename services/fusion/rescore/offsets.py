"""What no model says beforehand: by how much each phone, and each access point, is louder than it was taken for.

One number each for the whole time, Gaussian. A block of readings is scored by what the blocks before it tell, and only
then learned from, so the scores add up to the joint likelihood of all readings (the chain rule) whatever their order:
a model pays for an offset once, and cannot have another for every stretch it does not explain.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

__all__ = ["Offsets"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


class Offsets:
    """The offsets of d devices and m access points under one model.

    Args:
        devices: d.
        device: dB, standard deviation of a device's offset beforehand.
        access_point: (m,) dB, likewise of an access point's; 0 where it is known.
    """

    def __init__(self, devices: int, device: float, access_point: Array) -> None:
        self._devices = devices
        self._mean = np.zeros(devices + len(access_point))
        self._covariance = np.diag(np.concatenate([np.full(devices, device**2), access_point**2]))

    def log_likelihood(self, residual: Array, device: int, access_point: Integers, covariance: Array) -> float:
        """Return the log-likelihood of one device's next block of readings, nats, and learn from them.

        Args:
            residual: (n,) readings less what the model expects, dB.
            device: which one.
            access_point: (n,) which ones.
            covariance: (n, n) dB², of the residuals were the offsets known.
        """
        points, which = np.unique(access_point, return_inverse=True)
        latent = np.append(device, self._devices + points)
        mixing = np.zeros((len(residual), len(latent)))
        mixing[:, 0] = 1.0
        mixing[np.arange(len(residual)), 1 + which] = 1.0
        spread = mixing @ self._covariance[latent]
        innovation = residual - mixing @ self._mean[latent]
        lower = np.linalg.cholesky(spread[:, latent] @ mixing.T + covariance)
        whitened = np.linalg.solve(lower, np.column_stack([innovation, spread]))
        self._mean += whitened[:, 1:].T @ whitened[:, 0]
        self._covariance -= whitened[:, 1:].T @ whitened[:, 1:]
        half_log_det = float(np.log(np.diag(lower)).sum())
        quadratic = float(whitened[:, 0] @ whitened[:, 0])
        return -0.5 * quadratic - half_log_det - 0.5 * len(residual) * math.log(2.0 * math.pi)
