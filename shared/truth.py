"""Where everybody really is: what the simulator tells the benchmarks, and nobody else may read.

It stands apart from the other messages and keys so that an import rule and a test can keep every service but the
simulator away from it: a tracker that could see the truth would prove nothing.
"""

from __future__ import annotations

from shared.keys import Keys
from shared.messages import Message

__all__ = ["GroundTruth", "truth_key"]


class GroundTruth(Message, frozen=True, kw_only=True):
    """Where everybody really is. From the simulator to the benchmarks only."""

    person: list[str] = []
    floor: list[str] = []
    x: list[float] = []
    y: list[float] = []
    device: list[str | None] = []

    @classmethod
    def columns(cls) -> tuple[str, ...]:
        """One entry per person."""
        return ("person", "floor", "x", "y", "device")


def truth_key(keys: Keys) -> str:
    """Return the key under which GroundTruth is published."""
    return f"{keys.root}/truth"
