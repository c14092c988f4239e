"""What is remembered of tracks near borders, and what one frame says of them: arrays, one row per pair."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["PAIR", "Crossing", "Frame", "Pairs", "ranges_of"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

PAIR = np.dtype(
    [
        ("code", np.int64),
        ("side", np.int8),
        ("touched", np.bool_),
        ("evidence", float),
        ("away", float),
        ("net", np.int64),
        ("t", float),
        ("x", float),
        ("y", float),
        ("anchor_t", float),
        ("anchor_x", float),
        ("anchor_y", float),
        ("near", float),
        ("near_x", float),
        ("near_y", float),
    ],
    align=True,
)
"""The state of one pair; ``code``: slot times borders plus border, by which they are sorted.

``side``: 1 inside of an area or left of a line, -1 outside or right, 0 at first on neither side of a line.
``evidence`` of being on the other side by now, and ``t``, ``x``, ``y``: since when and from where (of a line: where it
was crossed last). ``touched``, of areas: since ``anchor``, when the track was last surely outside, it or a step of its
lay inside; of whoever was first seen inside the anchor has a time and no place. ``near``: the weight of the positions
lately near the border, one each at most, and the sums of these by their weights (``ways``). ``away``: evidence of being
outside since then, or at first of being right of a line. ``net``, of lines: how often it was crossed from left to
right, less how often back. Rows are fetched by ``take`` and ``compress`` and stored by ``put``: an index in brackets
costs ten times as much, for records.
"""


@dataclass(frozen=True, slots=True)
class Crossing:
    """One track entered or left one area, or crossed one line, at ``t`` near (x, y).

    ``absorbed``: it turned out to be somebody who is inside under another number: it is gone, and nobody left.
    ``lost``: nobody could see when they left, nor whether: they are let go without a word.
    ``who`` is the person: the number of the first of the tracks that are known to be one.
    """

    kind: Literal["enter", "exit", "cross", "absorbed", "lost"]
    border: int
    track: int
    who: int
    t: float
    x: float
    y: float
    direction: Literal["forward", "backward"] | None = None
    heir: int = 0
    """Of ``absorbed``: who it turned out to be."""


@dataclass(frozen=True)
class Frame:
    """All (n,) tracks of one frame at ``t``, and where they were before; ``known``: that there is a before."""

    t: float
    slot: Ints
    track: Ints
    who: Ints
    floor: Ints
    x: Floats
    y: Floats
    covariance: Floats
    """(n, 3): xx, xy, yy in m²."""
    before_t: Floats
    before_x: Floats
    before_y: Floats
    known: Bools

    @cached_property
    def segments(self) -> Floats:
        """(n, 2, 2): from there to here."""
        return np.stack([np.column_stack([self.before_x, self.before_y]), np.column_stack([self.x, self.y])], axis=1)

    @cached_property
    def spread(self) -> Floats:
        """(n,) metres, standard deviation along the longer axis."""
        xx, xy, yy = self.covariance.T
        spread: Floats = np.sqrt(0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy))
        return spread


@dataclass(frozen=True, slots=True)
class Pairs:
    """The (m,) pairs of a track of a frame and a border that may change or matter now."""

    row: Ints
    """Place of the track in the frame."""
    border: Ints
    depth: Floats
    sigma: Floats
    """Metres, standard deviation of the depth."""
    margin: Floats
    sure: Floats
    """Metres from the border at which somebody is surely on one side."""
    demand: Floats
    """Standard deviations by which the confidence asked for is more than a half."""
    narrow: Bools
    """Whether it is of an area no wider than its tracks' places are known."""
    net: Ints
    crossed: Bools
    """Whether the step that led here cuts the border."""
    share: Floats
    """Of the step at which it does last."""

    def pick(self, rows: Ints) -> Pairs:
        """Return some of them."""
        return Pairs(*(getattr(self, name)[rows] for name in self.__slots__))


def ranges_of(codes: Ints, slots: Ints, borders: int) -> tuple[Ints, Ints]:
    """Return where the pairs of each of (k,) slots begin and end among sorted codes."""
    return np.searchsorted(codes, slots * borders), np.searchsorted(codes, (slots + 1) * borders)
