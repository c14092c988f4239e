"""Which people, standing where, would have left this foreground? Person-sized templates placed greedily on the mask.

A blob says neither how many people it is nor where each stands. The camera's geometry does: a person of known size
whose feet are at a given pixel covers a known patch of the picture. Every foot point of a grid is asked how well it is
filled; the best is taken, its patch cleared, and the rest asked again. All sums are four look-ups in an integral image,
and the patches are computed once per camera.

A patch is the body cut into slices, each a box around its piece of the projected cylinder, so that people who lean in
the picture (towards the edge of a wide lens) or are seen from above have patches that lean or shrink as they do.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from services.camera.detector import Detections
from shared.site import CameraGeometry

__all__ = ["PersonTemplates"]

SLICES = 4
STRIDE = 2
"""Pixels between foot points; the mask is small (see ``foreground``), so this is a few centimetres to decimetres."""
SMALLEST = 10.0
"""Pixels of expected height below which a person cannot be told from noise."""
FARTHEST = 150.0
"""Metres: beyond it a pixel spans metres of floor and a position says nothing."""
MARGIN = 0.25
"""Share of the picture's height around it in which feet are looked for: people half in view must not be pulled in."""
VISIBLE = 0.5
"""Share of a patch that must lie inside the picture."""
CLEARED = 1.2
"""How much wider than a person is what their taking clears: arms and the smear of the mask belong to them."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class PersonTemplates:
    """The patches of one camera: row i belongs to a person with feet at ``feet[i]``.

    Attributes:
        shape: height and width of the mask.
        feet: (n, 2) pixels.
        heads: (n, 2) pixels of the top of the head.
        corners: (n, 4 · SLICES) flat indices into the integral image, ordered by corner: all +, all −.
        area: (n,) pixels inside the picture, overlapping slices counted as often as they overlap.
        slices: (n, SLICES, 4) left, top, right, bottom of each slice, not clipped.
        hulls: (n, 4) the same of the whole patch.
        whole: (n, 4) flat indices of the clipped hull's corners: +, +, −, −.
        density: least share of the patch that counts as filled background noise.
    """

    shape: tuple[int, int]
    feet: Floats
    heads: Floats
    corners: Ints
    area: Floats
    slices: Ints
    hulls: Floats
    whole: Ints
    density: float

    @classmethod
    def build(cls, geometry: CameraGeometry, height: float, width: float, density: float) -> PersonTemplates:
        """Return the patches of people ``height`` tall and ``width`` wide, metres, in the geometry's pictures."""
        columns, rows = geometry.image_size
        margin = MARGIN * rows
        u, v = np.meshgrid(np.arange(-margin, columns + margin, STRIDE), np.arange(0.0, rows + margin, STRIDE))
        feet = np.column_stack([u.ravel(), v.ravel()])
        ground = geometry.to_ground(feet)
        distance = np.linalg.norm(ground - geometry.position[:2], axis=1)
        keep = distance < FARTHEST  # NaN, above the horizon, compares false
        feet, ground = feet[keep], ground[keep]

        levels = np.linspace(0.0, height, SLICES + 1)
        axis = np.stack([_at_height(geometry, ground, level) for level in levels], axis=1)
        middle = 0.5 * (axis[:, 1:] + axis[:, :-1])
        reach = 0.5 * np.abs(axis[:, 1:] - axis[:, :-1])
        radius = np.stack(
            [
                _disc_radii(geometry, ground, 0.5 * (low + high), 0.5 * width)
                for low, high in itertools.pairwise(levels)
            ],
            axis=1,
        )
        half = np.maximum(reach, radius)
        boxes = np.concatenate([middle - half, middle + half], axis=2)
        boxes[..., 2:] = np.maximum(np.rint(boxes[..., 2:]), np.rint(boxes[..., :2]) + 1.0)
        boxes[..., :2] = np.rint(boxes[..., :2])
        hulls = np.concatenate([boxes[..., :2].min(axis=1), boxes[..., 2:].max(axis=1)], axis=1)

        full = np.prod(boxes[..., 2:] - boxes[..., :2], axis=2).sum(axis=1)
        limit = np.array([columns, rows, columns, rows], float)
        slices = boxes
        boxes = np.clip(boxes, 0.0, limit)
        area = np.prod(boxes[..., 2:] - boxes[..., :2], axis=2).sum(axis=1)
        extent = np.linalg.norm(axis[:, -1] - axis[:, 0], axis=1) + 2.0 * radius[:, -1, 1]
        with np.errstate(invalid="ignore", divide="ignore"):
            good = np.isfinite(full) & (area > 0.0) & (area >= VISIBLE * full) & (extent >= SMALLEST)
        boxes = boxes[good].astype(np.int64)
        clipped = np.clip(hulls[good], 0.0, limit).astype(np.int64)
        pitch = columns + 1
        left, top, right, bottom = (boxes[..., side] for side in range(4))
        corners = np.concatenate(
            [bottom * pitch + right, top * pitch + left, top * pitch + right, bottom * pitch + left], axis=1
        )
        x0, y0, x1, y1 = clipped.T
        whole = np.stack([y1 * pitch + x1, y0 * pitch + x0, y0 * pitch + x1, y1 * pitch + x0], axis=1)
        return cls(
            shape=(rows, columns),
            feet=feet[good],
            heads=axis[good, -1],
            corners=corners,
            area=area[good],
            slices=slices[good].astype(np.int64),
            hulls=hulls[good],
            whole=whole,
            density=density,
        )

    def split(self, mask: NDArray[np.uint8], least_gain: float) -> Detections:
        """Return the people whose patches explain ``mask`` best.

        Args:
            mask: (height, width), 1 where there is foreground; parts that were explained are cleared in place.
            least_gain: a person is taken while (filled − density · area) exceeds this share of the patch.

        Returns:
            Detections in pixels of the mask; confidence is the share of the patch that was filled when it was taken.
        """
        threshold = self.density + least_gain
        integral = _integral(mask)
        plus = integral.take(self.whole[:, :2]).sum(axis=1)
        some = plus - integral.take(self.whole[:, 2:]).sum(axis=1)
        # No slice holds more than the hull does: an exact bound that spares most foot points their look-ups.
        candidates = np.flatnonzero(some * SLICES >= threshold * self.area)
        taken: list[int] = []
        fills: list[float] = []
        refined: list[Floats] = []
        while candidates.size:
            filled = self._filled(integral, candidates)
            area = self.area[candidates]
            alive = filled >= threshold * area
            candidates, filled, area = candidates[alive], filled[alive], area[alive]
            if not candidates.size:
                break
            score = (filled - self.density * area) / np.sqrt(area)
            best = self._apart(candidates, score)
            people = candidates[best].tolist()
            taken += people
            fills += (filled[best] / area[best]).tolist()
            refined += [self._foot(mask, person) for person in people]
            for person in people:
                self._clear(mask, person)
            integral = _integral(mask)
        if not taken:
            return Detections.none()
        feet = np.array(refined)
        shift = feet - self.feet[taken]
        hulls = self.hulls[taken]
        boxes = np.column_stack([hulls[:, :2] + shift, hulls[:, 2:] - hulls[:, :2]])
        return Detections(feet, boxes, np.clip(np.array(fills), 0.0, 1.0))

    def _filled(self, integral: NDArray[np.int32], candidates: Ints) -> Floats:
        sums = integral.take(self.corners[candidates]).astype(np.int64)
        added = sums[:, : 2 * SLICES].sum(axis=1)
        filled: Floats = (added - sums[:, 2 * SLICES :].sum(axis=1)).astype(np.float64)
        return filled

    def _apart(self, candidates: Ints, score: Floats) -> list[int]:
        """Return positions of the best candidates whose patches do not touch each other's: they cannot compete."""
        hulls = self.hulls[candidates]
        open_ = np.ones(len(candidates), bool)
        best: list[int] = []
        for position in np.argsort(-score, kind="stable"):
            if open_[position]:
                best.append(int(position))
                left, top, right, bottom = hulls[position]
                wider = 0.1 * (right - left)
                open_ &= (
                    (hulls[:, 0] >= right + wider)
                    | (hulls[:, 2] <= left - wider)
                    | (hulls[:, 1] >= bottom)
                    | (hulls[:, 3] <= top)
                )
                if not open_.any():
                    break
        return best

    def _window(self, person: int, wider: float, taller: float) -> tuple[int, int, int, int]:
        left, top, right, bottom = self.hulls[person]
        dx, dy = wider * (right - left), taller * (bottom - top)
        rows, columns = self.shape
        x0, x1 = np.clip([np.floor(left - dx), np.ceil(right + dx)], 0, columns).astype(int)
        y0, y1 = np.clip([np.floor(top - dy), np.ceil(bottom + dy)], 0, rows).astype(int)
        return int(x0), int(y0), int(x1), int(y1)

    def _foot(self, mask: NDArray[np.uint8], person: int) -> Floats:
        foot: Floats = self.feet[person]
        return foot

    def _clear(self, mask: NDArray[np.uint8], person: int) -> None:
        for x0, y0, x1, y1 in self.slices[person].tolist():
            wider = round(0.5 * (CLEARED - 1.0) * (x1 - x0))
            mask[max(y0, 0) : max(y1, 0), max(x0 - wider, 0) : max(x1 + wider, 0)] = 0


def _integral(mask: NDArray[np.uint8]) -> NDArray[np.int32]:
    return cast(NDArray[np.int32], cv2.integral(mask)).ravel()


def _at_height(geometry: CameraGeometry, ground: Floats, height: float) -> Floats:
    return geometry.to_image(np.column_stack([ground, np.full(len(ground), height)]))


def _disc_radii(geometry: CameraGeometry, ground: Floats, height: float, radius: float) -> Floats:
    """Half-width and half-height (n, 2), pixels, of a level disc of ``radius`` metres at ``height`` over ``ground``."""
    angles = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    rim = np.stack([_at_height(geometry, ground + radius * np.array([np.cos(a), np.sin(a)]), height) for a in angles])
    spread: Floats = 0.5 * (rim.max(axis=0) - rim.min(axis=0))
    return spread
