"""Where on the floor do these feet stand, and how well is it known? Foot pixels to metres with covariance.

A foot pixel is wrong by a share of how tall the person *appears*; carried through the camera's geometry that is an
ellipse which stretches along the line of sight and grows with distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from services.camera.detector import Detections
from shared.site import CameraGeometry

__all__ = ["GroundDetections", "Projection", "aligned"]

FOOT_SIGMA = 0.05
"""Standard deviation of a foot pixel across and down the picture, share of the person's apparent height."""
FLOOR_SIGMA = 0.1
"""Metres: a person's middle is not quite above where the feet are seen."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class GroundDetections:
    """The people of one picture on the floor, as parallel arrays.

    Attributes:
        positions: (n, 2) metres on the plan.
        covariances: (n, 2, 2) m².
        boxes: (n, 4) left, top, width, height in pixels of the delivered picture.
        confidence: (n,) in [0, 1].
    """

    positions: Floats
    covariances: Floats
    boxes: Floats
    confidence: Floats


class Projection:
    """Carries detections of one camera to the floor.

    Args:
        geometry: the camera as calibrated; pictures of another size are scaled to it.
        size: width and height of the delivered pictures.
        area_of_interest: corners in pixels of the *geometry's* picture; feet outside it are ignored.
    """

    def __init__(
        self,
        geometry: CameraGeometry,
        size: tuple[int, int],
        area_of_interest: Sequence[tuple[float, float]] | None = None,
    ) -> None:
        self.geometry = geometry.scaled_to(*size)
        self._size = size
        # Corners count from the picture's corner, pixel centres from half a pixel inside it.
        scale = np.divide(size, geometry.image_size)
        self._interest = None
        if area_of_interest is not None:
            self._interest = shapely.Polygon((np.asarray(area_of_interest, float) + 0.5) * scale - 0.5)
            shapely.prepare(self._interest)

    def to_floor(self, found: Detections) -> GroundDetections:
        """Return the detections whose feet stand on visible floor inside the picture and the area of interest."""
        width, height = self._size
        u, v = found.feet.T
        keep = (u >= -0.5) & (u <= width - 0.5) & (v >= -0.5) & (v <= height - 0.5)
        if self._interest is not None:
            keep &= shapely.intersects_xy(self._interest, u, v)
        positions = self.geometry.to_ground(found.feet)
        covariances = self._covariances(found.feet, found.boxes[:, 3])
        keep &= np.isfinite(positions).all(axis=1) & np.isfinite(covariances).all(axis=(1, 2))
        return GroundDetections(
            positions=positions[keep],
            covariances=covariances[keep],
            boxes=found.boxes[keep],
            confidence=np.clip(found.confidence[keep], 0.0, 1.0),
        )

    def _covariances(self, feet: Floats, heights: Floats) -> Floats:
        spread = self.geometry.ground_jacobian(feet) * (FOOT_SIGMA * heights)[:, None, None]
        covariances: Floats = spread @ spread.transpose(0, 2, 1) + FLOOR_SIGMA**2 * np.eye(2)
        return covariances


def aligned(found: GroundDetections, homography: Floats) -> GroundDetections:
    """Return detections after a learned correction (3, 3) of the plan (``CameraAlignment``).

    Covariances go through its Jacobian. Who would come to stand beyond the horizon of the correction is dropped.
    """
    scale = found.positions @ homography[2, :2] + homography[2, 2]
    there = scale > 0.0
    if not there.all():
        found = GroundDetections(*(getattr(found, name)[there] for name in GroundDetections.__dataclass_fields__))
        scale = scale[there]
    positions = (found.positions @ homography[:2, :2].T + homography[:2, 2]) / scale[:, None]
    jacobian = (homography[:2, :2] - positions[:, :, None] * homography[2, :2]) / scale[:, None, None]
    covariances = jacobian @ found.covariances @ jacobian.transpose(0, 2, 1)
    return replace(found, positions=positions, covariances=covariances)
