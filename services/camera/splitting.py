"""Which people, standing where, would have left this foreground? Person-sized templates placed greedily on the mask.

A blob says neither how many people it is nor where each stands. The camera's geometry does: a person of known size
whose feet are at a given pixel covers a known patch of the picture. Every foot point of a grid is asked how well it is
filled; the best is taken, its patch cleared, and the rest asked again. All sums are four look-ups in an integral image,
and the patches are computed once per camera.

A patch is the body cut into slices, each a box around its piece of the projected cylinder, so that people who lean in
the picture (towards the edge of a wide lens) or are seen from above have patches that lean or shrink as they do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from services.camera.detector import Detections
from services.camera.size_prior import SizePrior
from shared.site import CameraGeometry

__all__ = ["PersonTemplates"]

SLICES = 4
STRIDE = 2
"""Pixels between foot points; the mask is small (see ``foreground``), so this is a few centimetres to decimetres."""
SMALLEST = 16.0
"""Pixels of expected height below which a person cannot be told from noise."""
FARTHEST = 150.0
"""Metres: beyond it a pixel spans metres of floor and a position says nothing."""
MARGIN = 0.25
"""Share of the picture's height around it in which feet are looked for: people half in view must not be pulled in."""
VISIBLE = 0.5
"""Share of a patch that must lie inside the picture."""
TALLER = 0.2
"""How far, as a share, people may be taller or shorter than expected."""
BENEATH = 0.2
"""Share of the height that is looked at under the feet: foreground there is somebody nearer, who must go first."""
TIE_BREAK = 0.05
"""Weight of foreground beside a patch: in a wide blob all patches are full, and people stand at its edges first."""
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
        corners: (n, 4 · SLICES) flat indices into the integral image of the slices, see ``_flat``.
        area: (n,) pixels inside the picture, overlapping slices counted as often as they overlap.
        slices: (n, SLICES, 4) left, top, right, bottom of each slice, not clipped.
        hulls: (n, 4) the same of the whole patch.
        whole: (n, 4) flat indices of the hull.
        beneath: (n, 4) flat indices of what lies under the feet, as far as it sticks out of the hull.
        around: (n, 4) flat indices of the hull and half its width on either side.
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
    beneath: Ints
    around: Ints
    density: float

    @classmethod
    def build(
        cls, geometry: CameraGeometry, height: float, width: float, density: float, prior: SizePrior | None = None
    ) -> PersonTemplates:
        """Return the patches of people ``height`` tall and ``width`` wide, metres, in the geometry's pictures.

        ``prior`` says by how much people look taller or smaller than that at each place; None: nowhere.
        """
        prior = prior or SizePrior()
        columns, rows = geometry.image_size
        margin = MARGIN * rows
        u, v = np.meshgrid(np.arange(-margin, columns + margin, STRIDE), np.arange(0.0, rows + margin, STRIDE))
        feet = np.column_stack([u.ravel(), v.ravel()])
        ground = geometry.to_ground(feet)
        distance = np.linalg.norm(ground - geometry.position[:2], axis=1)
        keep = distance < FARTHEST  # NaN, above the horizon, compares false
        feet, ground = feet[keep], ground[keep]

        tall = height * prior.heights(feet, geometry.image_size)
        width = width * prior.width
        levels = np.linspace(0.0, 1.0, SLICES + 1)[:, None] * tall
        axis = np.stack([_at_height(geometry, ground, level) for level in levels], axis=1)
        middle = 0.5 * (axis[:, 1:] + axis[:, :-1])
        reach = 0.5 * np.abs(axis[:, 1:] - axis[:, :-1])
        centres = 0.5 * (levels[1:] + levels[:-1])
        radius = np.stack([_disc_radii(geometry, ground, level, 0.5 * width) for level in centres], axis=1)
        half = np.maximum(reach, radius)
        boxes = np.concatenate([middle - half, middle + half], axis=2)
        boxes[..., 2:] = np.maximum(np.rint(boxes[..., 2:]), np.rint(boxes[..., :2]) + 1.0)
        boxes[..., :2] = np.rint(boxes[..., :2])
        hulls = np.concatenate([boxes[..., :2].min(axis=1), boxes[..., 2:].max(axis=1)], axis=1)

        full = np.prod(boxes[..., 2:] - boxes[..., :2], axis=2).sum(axis=1)
        limit = np.array([columns, rows, columns, rows], float)
        deep = np.maximum(np.rint(_at_height(geometry, ground, -BENEATH * tall)[:, 1]), hulls[:, 3])
        under = np.clip(np.stack([boxes[:, 0, 0], hulls[:, 3], boxes[:, 0, 2], deep], axis=1), 0.0, limit)
        slices = boxes
        boxes = np.clip(boxes, 0.0, limit)
        area = np.prod(boxes[..., 2:] - boxes[..., :2], axis=2).sum(axis=1)
        extent = np.linalg.norm(axis[:, -1] - axis[:, 0], axis=1) + 2.0 * radius[:, -1, 1]
        with np.errstate(invalid="ignore", divide="ignore"):
            good = np.isfinite(full) & (area > 0.0) & (area >= VISIBLE * full) & (extent >= SMALLEST)
        clipped = np.clip(hulls, 0.0, limit)
        wider = np.rint(0.5 * (hulls[:, 2] - hulls[:, 0]))
        zero = np.zeros_like(wider)
        around = np.clip(hulls + np.stack([-wider, zero, wider, zero], axis=1), 0.0, limit)
        return cls(
            shape=(rows, columns),
            feet=feet[good],
            heads=axis[good, -1],
            corners=_flat(boxes[good].astype(np.int64), columns),
            area=area[good],
            slices=slices[good].astype(np.int64),
            hulls=hulls[good],
            whole=_flat(clipped[good, None].astype(np.int64), columns),
            beneath=_flat(under[good, None].astype(np.int64), columns),
            around=_flat(around[good, None].astype(np.int64), columns),
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
        some = _sums(integral, self.whole)
        # No slice holds more than the hull does: an exact bound that spares most foot points their look-ups.
        candidates = np.flatnonzero(some * SLICES >= threshold * self.area)
        taken: list[int] = []
        fills: list[float] = []
        refined: list[Floats] = []
        while candidates.size:
            filled = _sums(integral, self.corners[candidates])
            area = self.area[candidates]
            alive = filled >= threshold * area
            candidates, filled, area = candidates[alive], filled[alive], area[alive]
            if not candidates.size:
                break
            beneath = _sums(integral, self.beneath[candidates])
            beside = _sums(integral, self.around[candidates]) - _sums(integral, self.whole[candidates])
            score = (filled - self.density * area - beneath - TIE_BREAK * beside) / np.sqrt(area)
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

    def _foot(self, mask: NDArray[np.uint8], person: int) -> Floats:
        """Return the foot pixel (2,): the lowest filled row of the body where the body shows whole, else a compromise.

        People are not all of one height: the patch of a tall one settles on the body, above the feet. Where the filled
        rows around the patch's middle end at a plausible height, their lower end is the foot; where only the head's end
        is seen, the expected height below it counts half. Bodies that lie across the picture keep the patch's foot.
        """
        foot: Floats = self.feet[person]
        body = foot - self.heads[person]
        if body[1] < abs(body[0]):
            return foot
        left, top, right, bottom = self.hulls[person].astype(int).tolist()
        expected = bottom - top
        slack = math.ceil(TALLER * expected)
        first = max(top - slack, 0)
        window = mask[first : max(bottom + slack, 0), max(left, 0) : max(right, 0)]
        rows: NDArray[np.bool_] = np.max(window, axis=1, initial=0) > 0
        middle = min(max((top + bottom) // 2 - first, 0), len(rows) - 1)
        empty_above, empty_below = np.flatnonzero(~rows[:middle]), np.flatnonzero(~rows[middle:])
        head = int(empty_above[-1]) + 1 if empty_above.size else None
        feet = middle + int(empty_below[0]) if empty_below.size else None
        if head is not None and feet is not None and abs(feet - head - expected) <= slack:
            shift = float(first + feet - bottom)
        elif head is not None:
            shift = 0.5 * (first + head - top)
        else:
            return foot
        shifted: Floats = foot + shift / body[1] * body
        return shifted

    def _clear(self, mask: NDArray[np.uint8], person: int) -> None:
        for x0, y0, x1, y1 in self.slices[person].tolist():
            wider = round(0.5 * (CLEARED - 1.0) * (x1 - x0))
            mask[max(y0, 0) : max(y1, 0), max(x0 - wider, 0) : max(x1 + wider, 0)] = 0


def _integral(mask: NDArray[np.uint8]) -> NDArray[np.int32]:
    return cast(NDArray[np.int32], cv2.integral(mask)).ravel()


def _sums(integral: NDArray[np.int32], corners: Ints) -> Floats:
    """Return the sums (n,) over boxes given as flat indices (n, 4 k): those of added corners, then of taken ones."""
    values = integral.take(corners)
    half = corners.shape[1] // 2
    signed = np.subtract(values[:, :half], values[:, half:], dtype=np.float64)
    sums: Floats = signed.sum(axis=1)
    return sums


def _flat(boxes: Ints, columns: int) -> Ints:
    """Return the flat indices (n, 4 k) into an integral image of the corners of k boxes (n, k, 4) each; see _sums."""
    left, top, right, bottom = (boxes[..., side] for side in range(4))
    pitch = columns + 1
    places = [bottom * pitch + right, top * pitch + left, top * pitch + right, bottom * pitch + left]
    return np.concatenate(places, axis=1)


def _at_height(geometry: CameraGeometry, ground: Floats, height: Floats) -> Floats:
    return geometry.to_image(np.column_stack([ground, height]))


def _disc_radii(geometry: CameraGeometry, ground: Floats, height: Floats, radius: float) -> Floats:
    """Half-width and half-height (n, 2), pixels, of discs of ``radius`` metres at ``height`` (n,) over ``ground``."""
    sight = ground - geometry.position[:2]
    sight /= np.maximum(np.linalg.norm(sight, axis=1, keepdims=True), 1e-9)
    centre = _at_height(geometry, ground, height)
    # Two perpendicular radii of the disc become two conjugate half-diameters of an ellipse.
    along = _at_height(geometry, ground + radius * sight, height) - centre
    aside = _at_height(geometry, ground + radius * sight[:, ::-1] * np.array([-1.0, 1.0]), height) - centre
    return np.hypot(along, aside)
