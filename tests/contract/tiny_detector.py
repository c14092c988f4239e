"""The smallest detector: bright things are people. Shows what a detector of one's own must provide."""

from typing import ClassVar, Literal

import cv2
import numpy as np
from pydantic import BaseModel

from services.camera.detector import Detections, Image
from shared.site import CameraGeometry


class BrightOptions(BaseModel, extra="forbid"):
    threshold: int = 200


class BrightDetector:
    Options: ClassVar[type[BaseModel]] = BrightOptions
    state: Literal["ready"] = "ready"

    def __init__(self, geometry: CameraGeometry, options: BrightOptions) -> None:
        self._options = options

    def reset(self) -> None:
        """Nothing is remembered."""

    def detect(self, image: Image, t: float) -> Detections:
        bright = (image.min(axis=2) >= self._options.threshold).astype(np.uint8)
        boxes = cv2.connectedComponentsWithStats(bright)[2][1:, :4].astype(float).reshape(-1, 4)
        boxes = boxes[boxes[:, 3] >= 20]
        feet = boxes[:, :2] + boxes[:, 2:] * [0.5, 1.0]
        return Detections(feet, boxes, np.ones(len(boxes)))
