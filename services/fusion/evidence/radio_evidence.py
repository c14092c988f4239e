"""How much does one scan say for each hypothesis about who carries the device? Exact, and a few array operations.

Under the hypothesis "this device is carried along this path", what an access point reads beyond the path-loss model is

    device offset + constant of the access point + shadowing of the place + white noise.

Shadowing fades with the distance walked, so a person who stands still adds next to nothing. Along a path it is a
Markov process: a Kalman filter of two states (constant, shadowing) per hypothesis and access point gives the
likelihood of each scan given those before it. The device's offset couples all access points; the filters carry their
response to it, which marginalises it exactly. ``shared.radio.log_likelihood`` is the slow form of the same model.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from shared.radio import RadioNoise

__all__ = ["PathFilters"]

Array = NDArray[np.float64]


@dataclass
class PathFilters:
    """Filters of d devices x k hypotheses x m access points.

    Attributes:
        constant, shadow: (d, k, m), estimates for a device without offset, dB.
        cc, cs, ss: (d, k, m), their covariance, dB².
        response_constant, response_shadow: (d, k, m), by how much a dB of device offset lowers the two estimates.
        offset, offset_variance: (d, k), the device's offset, dB and dB².
    """

    constant: Array
    shadow: Array
    cc: Array
    cs: Array
    ss: Array
    response_constant: Array
    response_shadow: Array
    offset: Array
    offset_variance: Array

    @classmethod
    def new(cls, devices: int, hypotheses: int, constant_variance: Array, noise: RadioNoise) -> PathFilters:
        """Return filters that have seen nothing; ``constant_variance`` is (m,), dB²."""
        shape = (devices, hypotheses, len(constant_variance))
        return cls(
            constant=np.zeros(shape),
            shadow=np.zeros(shape),
            cc=np.broadcast_to(constant_variance, shape).copy(),
            cs=np.zeros(shape),
            ss=np.full(shape, noise.shadowing**2),
            response_constant=np.zeros(shape),
            response_shadow=np.zeros(shape),
            offset=np.zeros(shape[:2]),
            offset_variance=np.full(shape[:2], noise.device**2),
        )

    def scan(
        self,
        device: int,
        rows: NDArray[np.int64],
        heard: NDArray[np.int64],
        residual: Array,
        kept: Array,
        variance: Array,
        white: float,
    ) -> Array:
        """Take in one scan and return its log-likelihood (n,) under each of ``rows``' hypotheses.

        Args:
            device: whose scan.
            rows: (n,), the hypotheses that say where the device was.
            heard: (h,), which access points were heard.
            residual: (n, h), heard minus expected at that place, dB.
            kept: (n,), how much of the shadowing of the scan before remains: exp(−distance / range).
            variance: (n, h), of the shadowing, dB².
            white: variance of the white noise, dB².
        """
        where = (device, rows[:, None], heard[None, :])
        keep = kept[:, None]
        constant, shadow = self.constant[where], self.shadow[where] * keep
        cc, cs = self.cc[where], self.cs[where] * keep
        ss = self.ss[where] * keep**2 + variance * (1.0 - keep**2)
        response_c, response_s = self.response_constant[where], self.response_shadow[where] * keep

        innovation = residual - constant - shadow
        slope = 1.0 - response_c - response_s
        spread = cc + 2.0 * cs + ss + white
        gain_c, gain_s = (cc + cs) / spread, (cs + ss) / spread

        self.constant[where] = constant + gain_c * innovation
        self.shadow[where] = shadow + gain_s * innovation
        self.response_constant[where] = response_c + gain_c * slope
        self.response_shadow[where] = response_s + gain_s * slope
        self.cc[where] = cc - gain_c * (cc + cs)
        self.cs[where] = cs - gain_c * (cs + ss)
        self.ss[where] = ss - gain_s * (cs + ss)

        before, variance_before = self.offset[device, rows], self.offset_variance[device, rows]
        information = (slope**2 / spread).sum(axis=1)
        variance_after = 1.0 / (1.0 / variance_before + information)
        after = variance_after * (before / variance_before + (slope * innovation / spread).sum(axis=1))
        self.offset[device, rows], self.offset_variance[device, rows] = after, variance_after
        misfit = (innovation**2 / spread).sum(axis=1) + before**2 / variance_before - after**2 / variance_after
        volume = np.log(2.0 * np.pi * spread).sum(axis=1) + np.log(variance_before / variance_after)
        result: Array = -0.5 * (misfit + volume)
        return result

    def fade(self, device: int, rows: NDArray[np.int64], unheard: NDArray[np.int64], kept: Array, level: Array) -> None:
        """Let the shadowing of access points not heard in this scan fade too; ``level`` is (n, u), its variance."""
        if not len(unheard):
            return
        where = (device, rows[:, None], unheard[None, :])
        keep = kept[:, None]
        self.shadow[where] *= keep
        self.cs[where] *= keep
        self.response_shadow[where] *= keep
        self.ss[where] = self.ss[where] * keep**2 + level * (1.0 - keep**2)

    def inherit(self, device: int, rows: NDArray[np.int64], parents: NDArray[np.int64]) -> None:
        """Let the hypotheses ``rows`` of one device go on from what ``parents`` knew."""
        for field in fields(self):
            array = getattr(self, field.name)
            array[device, rows] = array[device, parents]

    def resize(self, devices: int, hypotheses: int, constant_variance: Array, noise: RadioNoise) -> None:
        """Make room for more devices or hypotheses."""
        grown = PathFilters.new(devices, hypotheses, constant_variance, noise)
        old = self.offset.shape
        for field in fields(self):
            getattr(grown, field.name)[: old[0], : old[1]] = getattr(self, field.name)
            setattr(self, field.name, getattr(grown, field.name))

    def reset(self, devices: slice, hypotheses: slice, constant_variance: Array, noise: RadioNoise) -> None:
        """Forget what these filters have seen."""
        fresh = PathFilters.new(1, 1, constant_variance, noise)
        for field in fields(self):
            getattr(self, field.name)[devices, hypotheses] = getattr(fresh, field.name)[0, 0]
