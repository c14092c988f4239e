"""How tall and wide are people in this camera's mask? Measured once a second on those who walk alone.

A piece of the mask that holds one person, touches nothing and is cut off by no edge shows its whole height. That is
held against the height the calibration expects of a person whose feet are where the piece ends, so that what is
learned does not depend on the sizes in use. Who has not moved since the last look is not measured again: furniture
that was moved, and people who stand, would outvote all who walk.

Kept are histograms by coarse cells of the picture, no picture and nobody's path. A robust plane through the cells'
medians is drawn towards the mean of the camera, and that towards what was configured, the more the fewer people walked.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from services.camera.detector import Detections
from services.camera.size_prior import SizePrior, from_middle
from shared.site import CameraGeometry

__all__ = ["PersonSizes"]

Array = NDArray[np.float64]

EVERY = 1.0
"""Seconds between two looks."""
MOVED = 0.5
"""Metres from all who were measured in the last look."""
SURE = 0.6
"""Confidence of a detection below which what was found may be no person."""
APART = 0.25
"""Share of its height and width around a person in which nothing else may be."""
SPECK = 0.02
"""Share of a person's area below which another piece is nothing."""
TALL = 24.0
"""Pixels of expected height below which a pixel more or less is too much."""
UPRIGHT = 1.5
"""Least expected height, in expected widths: seen from above a body's thickness is measured, not its height."""
COLUMNS, ROWS = 4, 3
"""Cells of the picture."""
BINS = np.linspace(math.log(0.6), math.log(1.6), 41)
"""Limits of the histograms: 2.5 % each. What is beyond them is no person standing on the floor."""
MOST = 2000.0
"""Measurements of a cell at which the older ones count half."""
LEAST = 60.0
"""Measurements without which nothing is said."""
RUN = 5.0
"""Measurements of one walk through a cell, about: they are of one person."""
SPREAD = 0.08
"""Standard deviation of people's heights as measured, share."""
MISFIT = 0.02
"""Standard deviation of a cell about the plane, share."""
MEAN_PRIOR, SLOPE_PRIOR = 0.1, 0.1
"""Standard deviations, share: of the factor of a calibration, and of how much it differs from the middle to an edge."""


class PersonSizes:
    """Gathers the sizes of one camera's people.

    Args:
        geometry: of the mask.
        height: metres that people are expected to be tall.
        width: metres that they are expected to be wide.
    """

    def __init__(self, geometry: CameraGeometry, height: float, width: float) -> None:
        self._geometry, self._height, self._width = geometry, height, width
        self._last = -math.inf
        self._before = np.zeros((0, 2))
        self._counts = np.zeros((ROWS * COLUMNS, len(BINS) - 1))
        self._places = np.zeros((ROWS * COLUMNS, 2))
        """Sums of where the measured stood; see ``from_middle``."""
        self._widths = np.zeros(len(BINS) - 1)

    def take(self, mask: NDArray[np.uint8], found: Detections, t: float) -> None:
        """Measure a mask (h, w) of 0 and 1, taken at ``t``, with the people ``found`` in it, if a look is due."""
        if 0.0 <= t - self._last < EVERY:
            return
        self._last = t
        boxes, filled = _pieces_of_one(mask, found)
        feet = np.column_stack([boxes[:, 0] + 0.5 * boxes[:, 2], boxes[:, 1] + boxes[:, 3]])
        ground = self._geometry.to_ground(feet)
        height, width = self._expected(ground)
        with np.errstate(invalid="ignore", divide="ignore"):
            usable = (height >= TALL) & (height >= UPRIGHT * width) & np.isfinite(ground).all(axis=1)
            tall = np.log(boxes[:, 3] / height)
            wide = np.log(filled / boxes[:, 3] / width)
        apart = np.linalg.norm(ground[:, None] - self._before, axis=2).min(axis=1, initial=np.inf)
        usable &= (tall > BINS[0]) & (tall < BINS[-1]) & (wide > BINS[0]) & (wide < BINS[-1])
        self._before = ground[usable]
        usable &= apart > MOVED
        places = from_middle(feet[usable], self._geometry.image_size)
        cells = _cells(places)
        np.add.at(self._counts, (cells, _bins(tall[usable])), 1.0)
        np.add.at(self._places, cells, places)
        np.add.at(self._widths, _bins(wide[usable]), 1.0)
        for cell in np.flatnonzero(self._counts.sum(axis=1) > MOST):
            self._counts[cell] *= 0.5
            self._places[cell] *= 0.5
        if self._widths.sum() > MOST:
            self._widths *= 0.5

    def learned(self) -> SizePrior | None:
        """Return the sizes learned so far; None while too few people walked."""
        counts, places, widths = self._counts.copy(), self._places.copy(), self._widths.copy()
        number = counts.sum(axis=1)
        if number.sum() < LEAST:
            return None
        known = number >= 1.0
        number = number[known]
        at = places[known] / number[:, None]
        median = np.array([_median(one) for one in counts[known]])
        weight = 1.0 / (SPREAD**2 * RUN / number + MISFIT**2)
        design = np.column_stack([np.ones(len(at)), at])
        prior = np.diag([MEAN_PRIOR**-2.0, SLOPE_PRIOR**-2.0, SLOPE_PRIOR**-2.0])
        normal = (design * weight[:, None]).T
        mean, right, down = np.linalg.solve(normal @ design + prior, normal @ median).tolist()
        certain = widths.sum() / RUN / (widths.sum() / RUN + (SPREAD / MEAN_PRIOR) ** 2)
        wide = certain * _median(widths)
        return SizePrior(round(math.exp(mean), 3), round(right, 3), round(down, 3), round(math.exp(wide), 3))

    def _expected(self, ground: Array) -> tuple[Array, Array]:
        """Return the height and width (n,), pixels, of people at ``ground`` (n, 2)."""
        nought, level = np.zeros((len(ground), 1)), np.full((len(ground), 1), self._height)
        sight = ground - self._geometry.position[:2]
        aside = sight[:, ::-1] * [-1.0, 1.0] / np.maximum(np.linalg.norm(sight, axis=1, keepdims=True), 1e-9)
        half = 0.5 * self._width * aside
        middle = 0.5 * level
        feet = self._geometry.to_image(np.hstack([ground, nought]))
        heads = self._geometry.to_image(np.hstack([ground, level]))
        left = self._geometry.to_image(np.hstack([ground - half, middle]))
        right = self._geometry.to_image(np.hstack([ground + half, middle]))
        return feet[:, 1] - heads[:, 1], np.linalg.norm(right - left, axis=1)


def _pieces_of_one(mask: NDArray[np.uint8], found: Detections) -> tuple[Array, Array]:
    """Return the boxes (n, 4) and areas (n,) of the pieces of a mask that show one person each, whole and alone."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    boxes, areas = stats[1:, :4].astype(float), stats[1:, 4].astype(float)
    low, high = boxes[:, :2], boxes[:, :2] + boxes[:, 2:]
    rows, columns = mask.shape
    whole = (low > 1.0).all(axis=1) & (high < [columns - 1.0, rows - 1.0]).all(axis=1)
    middles = found.boxes[:, :2] + 0.5 * found.boxes[:, 2:]
    holds = ((middles >= low[:, None]) & (middles <= high[:, None])).all(axis=2)
    one = (holds.sum(axis=1) == 1) & (holds & (found.confidence >= SURE)).any(axis=1) & whole
    chosen = np.flatnonzero(one)
    around = APART * boxes[chosen, 2:]
    near = ((low < (high[chosen] + around)[:, None]) & (high > (low[chosen] - around)[:, None])).all(axis=2)
    near &= areas > SPECK * areas[chosen, None]
    alone = near.sum(axis=1) == 1  # itself
    return boxes[chosen[alone]], areas[chosen[alone]]


def _cells(places: Array) -> NDArray[np.int64]:
    column = np.minimum((0.5 * (places[:, 0] + 1.0) * COLUMNS).astype(int), COLUMNS - 1)
    row = np.minimum((0.5 * (places[:, 1] + 1.0) * ROWS).astype(int), ROWS - 1)
    cells: NDArray[np.int64] = row * COLUMNS + column
    return cells


def _bins(value: Array) -> NDArray[np.int64]:
    return np.clip(np.searchsorted(BINS, value) - 1, 0, len(BINS) - 2)


def _median(counts: Array) -> float:
    """Return the median of what a histogram holds."""
    below = np.concatenate([[0.0], np.cumsum(counts)])
    return float(np.interp(0.5 * below[-1], below, BINS))
