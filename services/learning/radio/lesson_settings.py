"""How often the radio is learned, from how much, and how soon it is forgotten."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["RadioLessonSettings"]


@dataclass(frozen=True)
class RadioLessonSettings:
    """How the radio is learned.

    Attributes:
        half_life: seconds of people about after which a visit counts half.
        every: seconds between two proposals.
        after_change: the same after something changed.
        visits: new ones that make a proposal worth while, and as many
        spots: square metres must have been visited lately.
        recent: seconds against which the last readings are held.
    """

    half_life: float = 2700.0
    every: float = 300.0
    after_change: float = 60.0
    visits: int = 150
    spots: int = 12
    recent: float = 300.0
