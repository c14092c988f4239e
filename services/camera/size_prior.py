"""How tall do people look at each place of the picture, held against what the calibration makes one expect?

A plane in the logarithm over the picture: one factor for all of it, and how it grows towards the right and the lower
edge. A calibration off in height is a factor; one off in tilt, a floor that is not level or a bent lens make it differ
from place to place. More than a plane would take more people than a camera sees in an hour.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["SizePrior", "from_middle"]

Array = NDArray[np.float64]

SMALLEST, LARGEST = 0.5, 2.0
"""Factors beyond which nobody is a person."""


@dataclass(frozen=True)
class SizePrior:
    """Factors of the expected size of people; in the order of ``shared.size_options``.

    Attributes:
        height: in the middle of the picture.
        right: how much the logarithm of the factor is larger at the right edge than in the middle.
        down: the same at the lower edge.
        width: of people's width, everywhere.
    """

    height: float = 1.0
    right: float = 0.0
    down: float = 0.0
    width: float = 1.0

    def heights(self, feet: Array, size: tuple[int, int]) -> Array:
        """Return the factor (n,) of people's height with ``feet`` (n, 2), pixels, in pictures of ``size``.

        Feet beyond an edge count as on it.
        """
        across, along = from_middle(feet, size).T
        factor: Array = self.height * np.exp(self.right * across + self.down * along)
        return factor.clip(SMALLEST, LARGEST)


def from_middle(feet: Array, size: tuple[int, int]) -> Array:
    """Return where pixels (n, 2) lie, -1 at the left and upper, 1 at the right and lower edge; none lies beyond."""
    places: Array = 2.0 * feet / np.array(size, float) - 1.0
    return places.clip(-1.0, 1.0)
