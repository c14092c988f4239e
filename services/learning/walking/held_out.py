"""Is a candidate better on what it was not taught by, and by more than chance? Errors of both in, a verdict out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["LEAST_GROUPS", "Gain", "gain_of"]

Array = NDArray[np.float64]

HUBER = 2.5
"""Standard deviations beyond which an error counts linearly: one wrong track decides nothing."""
LEAST_GAIN = 0.05
"""Nats per observation."""
SURE = 2.0
"""Standard errors of the mean over groups which a gain must exceed."""
LEAST_GROUPS = 4


@dataclass(frozen=True)
class Gain:
    """How much better a candidate explains held-out observations.

    Attributes:
        mean: nats per observation, the mean over groups.
        margin: what it has to exceed.
        before: root mean square error of what is in use.
        after: of the candidate.
        groups: of observations that share their errors.
    """

    mean: float
    margin: float
    before: float
    after: float
    groups: int

    @property
    def significant(self) -> bool:
        """Whether it wins."""
        return self.groups >= LEAST_GROUPS and self.mean > self.margin


def gain_of(before: Array, after: Array, group: NDArray[Any], sigma: float) -> Gain:
    """Return the gain of a candidate.

    Args:
        before: (n,) errors of what is in use.
        after: (n,) errors of the candidate on the same observations.
        group: (n,) which of them share their errors, such as those of one stretch or walk.
        sigma: standard deviation of an error of a model that is right.
    """
    numbers, which = np.unique(group, return_inverse=True)
    if len(numbers) < 2:
        return Gain(0.0, LEAST_GAIN, 0.0, 0.0, len(numbers))
    nats = _cost(before / sigma) - _cost(after / sigma)
    means = np.bincount(which, nats) / np.bincount(which)
    error = float(means.std(ddof=1)) / np.sqrt(len(means))
    return Gain(
        mean=float(means.mean()),
        margin=max(LEAST_GAIN, SURE * error),
        before=float(np.sqrt(np.mean(before**2))),
        after=float(np.sqrt(np.mean(after**2))),
        groups=len(numbers),
    )


def _cost(off: Array) -> Array:
    size = np.abs(off)
    cost: Array = np.where(size < HUBER, 0.5 * size**2, HUBER * (size - 0.5 * HUBER))
    return cost
