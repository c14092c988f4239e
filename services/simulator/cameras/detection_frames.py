"""How do detections in the picture become the messages a camera publishes? As the camera service makes them."""

from __future__ import annotations

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from shared.messages import DetectionFrame
from shared.site import Camera, CameraGeometry

__all__ = ["FramePublisher", "frame_numbers", "published_covariances"]

Array = NDArray[np.float64]
Ints = NDArray[np.intp]

FOOT_SIGMA = 0.05
"""What the camera service says of its feet: standard deviation as a share of the apparent height,"""
FLOOR_SIGMA = 0.1
"""and metres on the floor."""


def frame_numbers(frames_per_s: float, start: float, end: float) -> Ints:
    """Return the numbers k of the frames with k / ``frames_per_s`` in [start, end)."""
    first, last = (math.ceil(t * frames_per_s - 1e-6) for t in (start, end))
    return np.arange(first, last, dtype=np.intp)


def published_covariances(geometry: CameraGeometry, foot: Array, apparent_height: Array) -> Array:
    """Return the covariances (n, 2, 2), m², that the camera service publishes of feet (n, 2), pixels."""
    spread = geometry.ground_jacobian(foot) * (FOOT_SIGMA * apparent_height)[:, None, None]
    covariances: Array = spread @ spread.transpose(0, 2, 1) + FLOOR_SIGMA**2 * np.eye(2)
    return covariances


class FramePublisher:
    """Turns rows of detections into the frames of one camera.

    Args:
        camera: whose they are; feet outside its picture or its area of interest are dropped.
        floor: its id.
        frames_per_s: frame k is taken at k / frames_per_s.
    """

    def __init__(self, camera: Camera, floor: str, frames_per_s: float) -> None:
        if not (math.isfinite(frames_per_s) and frames_per_s > 0.0):
            raise ValueError(f"frames_per_s: {frames_per_s} found, allowed: above 0")
        self.camera = camera.id
        self.floor = floor
        self.frames_per_s = frames_per_s
        self.geometry = camera.geometry.build()
        self._interest = None
        if camera.area_of_interest is not None:
            self._interest = shapely.Polygon(camera.area_of_interest)
            shapely.prepare(self._interest)

    @property
    def interest(self) -> shapely.Polygon | None:
        """Where feet are looked for, pixels; None: in the whole picture."""
        return self._interest

    def frames(self, numbers: Ints, row: Ints, foot: Array, box: Array, confidence: Array) -> list[DetectionFrame]:
        """Return one frame per number, the surest detections first.

        Args:
            numbers: (n,) of the frames.
            row: (m,) places in ``numbers`` of the detections.
            foot: (m, 2) pixels.
            box: (m, 4) left, top, right, bottom, pixels.
            confidence: (m,) in [0, 1].
        """
        width, height = self.geometry.image_size
        with np.errstate(invalid="ignore"):
            keep = (foot >= -0.5).all(axis=1) & (foot[:, 0] <= width - 0.5) & (foot[:, 1] <= height - 0.5)
        if self._interest is not None:
            keep &= shapely.intersects_xy(self._interest, foot[:, 0], foot[:, 1])
        keep &= np.isfinite(box).all(axis=1)
        order = np.lexsort((-confidence, row))
        order = order[keep[order]]
        row, foot, box, confidence = row[order], foot[order], box[order].copy(), confidence[order]
        box[:, 2:] -= box[:, :2]
        place = self.geometry.to_ground(foot)
        matrices = published_covariances(self.geometry, foot, box[:, 3])
        good = np.isfinite(place).all(axis=1) & np.isfinite(matrices).all(axis=(1, 2))
        row, place, box, confidence, matrices = row[good], place[good], box[good], confidence[good], matrices[good]
        x, y = place[:, 0].tolist(), place[:, 1].tolist()
        packed = list(zip(*(matrices[:, i, j].tolist() for i, j in ((0, 0), (0, 1), (1, 1))), strict=True))
        boxes = list(zip(*(box[:, side].tolist() for side in range(4)), strict=True))
        sure = confidence.tolist()
        stops = np.searchsorted(row, np.arange(len(numbers) + 1)).tolist()
        return [
            DetectionFrame(
                t=number / self.frames_per_s,
                camera=self.camera,
                floor=self.floor,
                seq=number,
                x=x[a:b],
                y=y[a:b],
                covariance=packed[a:b],
                confidence=sure[a:b],
                box=boxes[a:b],
            )
            for number, a, b in zip(numbers.tolist(), stops[:-1], stops[1:], strict=True)
        ]
