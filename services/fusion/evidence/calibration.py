"""What do access points really send? Their power and exponent, learned from phones whose track is known for sure.

The site file's values are first guesses that may be wrong by several dB. Each access point has a Bayesian linear
regression of the readings' residual on 1 and −10 log₁₀ distance [ravel-thesis §8.4, with a prior]; readings taken on
the same spot share their shadowing and count once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.fusion.snapshot import of_shape, unpack
from shared.radio import PathLoss

__all__ = ["Calibration"]

Array = NDArray[np.float64]

POWER_SIGMA = 5.0
"""dB, and of the exponent: how far the site file's guesses may be off."""
EXPONENT_SIGMA = 0.25
LEARNED = 0.3
"""How much of that remains where a model was learned."""
BELIEVED = 30.0
"""Readings as which the noise believed beforehand counts, and the least and the largest factor on its variance."""
NOISE = (0.5, 4.0)
TYPICAL = 10.0
"""10 log₁₀ of the distance at which the remaining uncertainty is told: ten metres."""


@dataclass
class Calibration:
    """Corrections of m access points.

    Attributes:
        guess: the site file's model.
        information: (m, 2, 2), precision of the correction of (power, exponent).
        evidence: (m, 2), precision times mean.
        correction: (m, 2), in use.
        misfit: (2,), sum of squared errors of readings whose place is known, in units of what they were expected to
            be, and number of those; what is believed beforehand counts as some of them.
    """

    guess: PathLoss
    information: Array
    evidence: Array
    correction: Array
    misfit: Array

    @classmethod
    def of(cls, guess: PathLoss, *, learned: bool = False) -> Calibration:
        """Start from the site file's guess, or from what was learned of the site before."""
        m = len(guess.names)
        known = LEARNED if learned else 1.0
        prior = np.diag([(known * POWER_SIGMA) ** -2, (known * EXPONENT_SIGMA) ** -2])
        return cls(
            guess, np.broadcast_to(prior, (m, 2, 2)).copy(), np.zeros((m, 2)), np.zeros((m, 2)), np.full(2, BELIEVED)
        )

    def rssi(self, places: Array) -> Array:
        """Return the expected signal strengths, (n, m) in dBm, at (n, 2) places."""
        return self.rssi_at(self.guess.log_distance(places))

    def rssi_at(self, distance: Array) -> Array:
        """Return the same, (n, m) in dBm, of (n, m) distances given as 10 log₁₀ of metres."""
        expected: Array = (self.guess.power_1m + self.correction[:, 0]) - (
            self.guess.exponent + self.correction[:, 1]
        ) * distance
        return expected

    def learn(self, heard: NDArray[np.int64], distance: Array, residual: Array, weight: Array) -> None:
        """Note one scan of a phone.

        Args:
            heard: (h,), which access points.
            distance: (h,), 10 log₁₀ of the distances.
            residual: (h,), what they read beyond what is expected now, the phone's own offset taken off, dB.
            weight: (h,), inverse variance of each, dB⁻²; less where place or offset are in doubt.
        """
        residual = residual + self.correction[heard, 0] - self.correction[heard, 1] * distance
        self.information[heard, 0, 0] += weight
        self.information[heard, 0, 1] -= weight * distance
        self.information[heard, 1, 0] -= weight * distance
        self.information[heard, 1, 1] += weight * distance**2
        self.evidence[heard, 0] += weight * residual
        self.evidence[heard, 1] -= weight * distance * residual

    @property
    def noise(self) -> float:
        """By how much readings vary more than they were expected to; a factor on variances."""
        return min(max(float(self.misfit[0] / self.misfit[1]), NOISE[0]), NOISE[1])

    def learn_noise(self, residual: Array, variance: Array, weight: float) -> None:
        """Note how well one scan of a phone fits whose place is known for sure.

        Args:
            residual: (h,) dB; what all have in common is the phone's own.
            variance: (h,) dB², expected of each.
            weight: how much of the scan is new, 0 to 1.
        """
        if len(residual) < 2:
            return
        share = 1.0 / variance
        off = residual - float((residual * share).sum() / share.sum())
        self.misfit += weight * np.array([float((off * off * share).sum()), len(residual) - 1.0])

    def solve(self) -> None:
        """Put what was learned to use."""
        (a, b), (_, d) = self.information[:, 0].T, self.information[:, 1].T
        determinant = a * d - b * b
        self.correction = np.column_stack(
            [
                (d * self.evidence[:, 0] - b * self.evidence[:, 1]) / determinant,
                (a * self.evidence[:, 1] - b * self.evidence[:, 0]) / determinant,
            ]
        )

    def variance(self) -> Array:
        """Return what is still uncertain of a reading ten metres away, (m,) in dB²."""
        (a, b), (_, d) = self.information[:, 0].T, self.information[:, 1].T
        remaining: Array = (d + 2.0 * b * TYPICAL + a * TYPICAL**2) / (a * d - b * b)
        return remaining

    def state(self) -> dict[str, Any]:
        """Return a copy of what was learned."""
        return {name: getattr(self, name).copy() for name in _LEARNED}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state()``."""
        for name in _LEARNED:
            setattr(self, name, of_shape(unpack(state[name]), getattr(self, name).shape))


_LEARNED = ("information", "evidence", "correction", "misfit")
