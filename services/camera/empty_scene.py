"""What does the scene look like without people? Learned where nobody is detected, kept in memory.

A background that begins with people in the picture takes them for furniture and leaves ghosts when they go; one that
begins with the empty scene does not. So the scene is learned aside, slowly and from quiet places only: whoever is not
detected for a while moves it by little, because no picture may change a pixel by more than a step.
"""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from services.camera.detector import Image

__all__ = ["EmptyScene"]

WIDTH = 960
"""Pixels across at most: what the shipped detector works on."""
EVERY = 2.0
"""Seconds between two looks."""
MEMORY = 150.0
"""Looks over which a known pixel is averaged."""
STEP = 12.0
"""Grey levels a single look may pull at a known pixel."""
KNOWN = 10
"""Looks at a pixel without anybody after which it is known."""
COMPLETE = 0.98
"""Share of the picture that must be known."""
WIDER = 0.5
"""Share of its own width and height by which a box is enlarged on each side: arms, shadows, what was cut off."""


class EmptyScene:
    """The empty scene of one camera."""

    def __init__(self) -> None:
        self._mean: NDArray[np.float32] | None = None
        self._looks = np.zeros((0, 0), np.uint16)
        self._last = -np.inf

    def take(self, image: Image, boxes: NDArray[np.float64], t: float) -> bool:
        """Learn from a picture (h, w, 3) taken at ``t`` with people in ``boxes`` (n, 4); return whether it was due.

        A picture of another size begins anew.
        """
        if abs(t - self._last) < EVERY:
            return False
        self._last = t
        height, width = image.shape[:2]
        if width > WIDTH:
            size = (WIDTH, max(round(height * WIDTH / width), 1))
            image = cast(Image, cv2.resize(image, size, interpolation=cv2.INTER_AREA))
            boxes = boxes * (WIDTH / width)
        if self._mean is None or self._mean.shape != image.shape:
            self._mean = np.zeros(image.shape, np.float32)
            self._looks = np.zeros(image.shape[:2], np.uint16)
        quiet = _outside(boxes, image.shape[1], image.shape[0])
        # Where a pixel is not known yet it is a plain mean, unbounded.
        young = self._looks < KNOWN
        weight = np.where(quiet, 1.0 / (np.minimum(self._looks, MEMORY) + 1.0), 0.0).astype(np.float32)
        change = image - self._mean
        np.clip(change, -STEP, STEP, out=change, where=~young[..., None])
        self._mean += weight[..., None] * change
        self._looks += quiet & (self._looks < np.iinfo(np.uint16).max)
        return True

    @property
    def picture(self) -> Image | None:
        """The scene (h, w, 3), no wider than ``WIDTH``; None before nearly all of it is."""
        mean = self._mean  # asked for by other threads too
        if mean is None or np.mean(self._looks >= KNOWN) < COMPLETE:
            return None
        return cast(Image, np.clip(mean + 0.5, 0.0, 255.0).astype(np.uint8))

    def begin(self, picture: Image) -> None:
        """Go on from a picture of the scene as it was."""
        self._mean = picture.astype(np.float32)
        self._looks = np.full(picture.shape[:2], KNOWN, np.uint16)

    def forget(self) -> None:
        """Begin anew: the camera looks elsewhere."""
        self._mean = None


def _outside(boxes: NDArray[np.float64], width: int, height: int) -> NDArray[np.bool_]:
    """Return the pixels (h, w) outside of all boxes, enlarged."""
    outside = np.ones((height, width), np.bool_)
    margin = WIDER * boxes[:, 2:]
    low = np.maximum(boxes[:, :2] - margin, 0.0).astype(int)
    high = np.maximum(boxes[:, :2] + boxes[:, 2:] + margin, 0.0).astype(int) + 1
    for (left, top), (right, bottom) in zip(low.tolist(), high.tolist(), strict=True):
        outside[top:bottom, left:right] = False
    return outside
