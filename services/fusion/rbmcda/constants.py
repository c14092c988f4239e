"""What do access points really send? Learned from all phones at once, from the biases their filters settle on.

The original hands this to an off-line learner [ravel-thesis §8.4]; untrained, the site file's constants may be off
by several dB, alike for every phone. Whoever a phone is taken for, its biases average over many places: even half of
the identities wrong teach the constants rightly, and right constants mend identities.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.fusion.snapshot import unpack

__all__ = ["Constants"]

Array = NDArray[np.float64]

ALIKE = 20.0
"""Seconds for which a phone's biases tell the same."""


class Constants:
    """Mean bias of M access points, and how sure it is.

    Args:
        bias: (M, M) dB², of a phone's biases while nothing is known.
        prior: dB², of it what all phones share.

    Attributes:
        mean: (M,) dB.
    """

    def __init__(self, bias: Array, prior: float) -> None:
        self._bias, self._prior = bias, prior
        self.mean: Array = np.zeros(len(bias))
        self._weight: Array = np.zeros(len(bias))

    @property
    def bias(self) -> Array:
        """What a phone's biases may differ from the mean, (M, M) dB²."""
        if self._prior <= 0.0:
            return self._bias
        own = np.diag(self._bias) - self._prior
        left = 1.0 / (1.0 / self._prior + self._weight / own)
        narrowed: Array = self._bias - np.diag(self._prior - left)
        return narrowed

    def learn(self, biases: Array, weight: Array, duration: float) -> None:
        """Take in (M, X) estimated biases of devices, each with a weight (X,) from 0 to 1, of so many seconds."""
        if self._prior <= 0.0:
            return
        share = weight * min(duration, 1.0) / ALIKE
        total = float(share.sum())
        if total > 0.0:
            own = np.diag(self._bias) - self._prior
            before = own / self._prior + self._weight
            self.mean = (before * self.mean + biases @ share) / (before + total)
            self._weight = self._weight + total

    def state(self) -> dict[str, Any]:
        """Return what was learned."""
        return {"mean": self.mean.copy(), "weight": self._weight.copy()}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state()``."""
        self.mean, self._weight = unpack(state["mean"]), unpack(state["weight"])
