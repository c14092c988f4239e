"""Whether a stretch may teach."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Verdict"]


@dataclass(frozen=True)
class Verdict:
    """What ``quality`` found of a stretch.

    Attributes:
        printed: Q of [ravel-thesis §8.1, Eq. 5.1], the sum of nats over the stretch.
        rate: nats per second, which does not depend on how long the stretch is.
        good: whether it may teach.
        reason: why not, in a few plain words that many stretches share; empty where it may.
        doubtful: where it may not: whether nothing speaks against it, so that it may teach who weighs what it is told.
    """

    printed: float
    rate: float
    good: bool
    reason: str = ""
    doubtful: bool = False
