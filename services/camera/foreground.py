"""Who stands before the background? Mixture-of-Gaussians subtraction, then person-sized templates on the mask.

Per picture: a global gain correction undoes what light and exposure control did to the whole picture; MOG2
[ravel-thesis §3.1] marks what differs from the background, its shadow test drops what is only darker; the mask is
cleaned and handed to ``splitting``. Everything is causal: the model starts cold on the first picture, people in it
included.
"""

from __future__ import annotations

import math
from dataclasses import astuple, replace
from typing import Any, ClassVar, Literal, cast

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from services.camera.detector import Detections, Image
from services.camera.person_sizes import PersonSizes
from services.camera.size_prior import SizePrior
from services.camera.splitting import PersonTemplates
from shared.site import CameraGeometry
from shared.size_options import SIZE_OPTIONS

__all__ = ["ForegroundDetector", "ForegroundOptions"]

FOREGROUND = 255
"""MOG2 marks shadows 127 and foreground 255."""
GAIN_STEP = 8
"""Every how many pixels the light is sampled."""
NOISE = 4.0
"""Grey levels of noise every camera has (compression, flicker): no background is held to be steadier."""
BACKGROUND_RATIO = 0.6
"""Share of a pixel's past that makes its background: with the default learning rate, who stands still for 50 s
becomes part of it (ln(1 / 0.6) / 0.01); OpenCV's 0.9 would forget people after 10 s."""
FLOOD = 0.6
"""A larger share of foreground than this is no crowd: the camera moved or the light jumped."""

LEARNING = 5.0
"""Seconds for which a new background still holds whoever stood there at first."""
GROWN_UP = 10_000_000
"""Pictures a background that did not begin cold counts as having seen."""


class ForegroundOptions(BaseModel):
    """What the foreground detector can be told. The defaults are meant to serve every site."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    learning_rate: float = Field(0.01, gt=0, le=10, description="share of the background renewed per second")
    sensitivity: float = Field(
        16.0, gt=1, le=200, description="squared standard deviations from the background that make foreground"
    )
    shadow_ratio: float = Field(0.6, gt=0, lt=1, description="down to this share of the light it is a shadow")
    person_height: float = Field(1.75, ge=0.5, le=2.5, description="metres")
    person_width: float = Field(0.4, ge=0.2, le=1.5, description="metres")
    height_scale: float = Field(1.0, ge=0.5, le=2.0, description="how tall people look, expected heights")
    height_scale_right: float = Field(
        0.0, ge=-0.5, le=0.5, description="logarithm by which that is larger at the right edge of the picture"
    )
    height_scale_down: float = Field(0.0, ge=-0.5, le=0.5, description="the same at its lower edge")
    width_scale: float = Field(1.0, ge=0.5, le=2.0, description="how wide people look, expected widths")
    density: float = Field(0.3, gt=0, lt=1, description="filled share of a person's patch that still means nothing")
    least_gain: float = Field(0.1, gt=0, lt=1, description="how much more of the patch must be filled")
    picture_width: int = Field(960, ge=64, description="wider pictures are shrunk to this before anything else, pixels")
    mask_width: int = Field(480, ge=64, description="the mask is shrunk to this before people are looked for, pixels")


class ForegroundDetector:
    """Background subtraction for one fixed camera.

    Args:
        geometry: of the pictures as they are delivered.
        options: see ``ForegroundOptions``.
    """

    Options: ClassVar[type[BaseModel]] = ForegroundOptions

    def __init__(self, geometry: CameraGeometry, options: ForegroundOptions | None = None) -> None:
        self._options = options or ForegroundOptions()
        width, height = geometry.image_size
        self._size = _within(width, height, self._options.picture_width)
        self._mask_size = _within(*self._size, self._options.mask_width)
        self._scale = np.array([width, height], float) / self._mask_size
        self._geometry = geometry.scaled_to(*self._mask_size)
        self._templates = self._built(self._options)
        self.forget_sizes()
        self.reset()

    @property
    def state(self) -> Literal["learning", "ready"]:
        """``learning`` during the first five seconds, while the background still holds whoever stood there at first."""
        return "ready" if self._seen > 1 and self._last - self._first >= LEARNING else "learning"

    @property
    def learned_sizes(self) -> dict[str, float]:
        """How tall and wide people were seen to be, as options; empty while too few walked."""
        learned = None if self._sizes is None else self._sizes.learned()
        return {} if learned is None else dict(zip(SIZE_OPTIONS, astuple(learned), strict=True))

    def forget_sizes(self, *, paused: bool = False) -> None:
        """Forget how tall and wide people were seen to be, and measure them anew unless that is ``paused``."""
        options = self._options
        self._sizes = None if paused else PersonSizes(self._geometry, options.person_height, options.person_width)

    def reset(self) -> None:
        """Forget the background."""
        self._model = cv2.createBackgroundSubtractorMOG2(500, self._options.sensitivity, True)
        self._model.setShadowThreshold(self._options.shadow_ratio)
        self._model.setBackgroundRatio(BACKGROUND_RATIO)
        self._model.setVarMin(NOISE**2)
        self._light: NDArray[np.float32] | None = None
        self._seen = 0
        self._first = self._last = 0.0
        self.mask = np.zeros(self._mask_size[::-1], np.uint8)

    def prime(self, empty: Image) -> None:
        """Begin anew with ``empty``, a picture of the scene without people, as the background."""
        self.reset()
        empty = self._shrunk(empty)
        self._model.apply(empty, learningRate=1.0)
        self._light = _sampled(empty)
        self._seen = GROWN_UP

    def adopt(self, options: ForegroundOptions) -> bool:
        """Go on with other ``options`` and the background as learned; False, and nothing is changed, if it cannot."""
        if any(getattr(options, name) != getattr(self._options, name) for name in _BUILT_FOR):
            return False
        if any(getattr(options, name) != getattr(self._options, name) for name in SIZE_OPTIONS):
            self._templates = self._built(options)
        self._options = options
        self._model.setVarThreshold(options.sensitivity)
        self._model.setShadowThreshold(options.shadow_ratio)
        self._templates = replace(self._templates, density=options.density)
        return True

    def recalibrate(self, geometry: CameraGeometry) -> None:
        """Go on with another calibration of the same pictures and the background as learned."""
        self._geometry = geometry.scaled_to(*self._mask_size)
        self._templates = self._built(self._options)
        self.forget_sizes(paused=self._sizes is None)

    def detect(self, image: Image, t: float) -> Detections:
        """Return the people in ``image``, taken at ``t``; see the protocol."""
        image = self._shrunk(image)
        rate = self._rate(t)
        marked = self._model.apply(self._corrected(image, rate), learningRate=rate)
        self.mask = self._cleaned(cast(NDArray[np.uint8], marked))
        if float(np.mean(self.mask)) > FLOOD:
            self._seen = 1  # learn afresh, as fast as at the start
            self._first = t
            return Detections.none()
        found = self._templates.split(self.mask.copy(), self._options.least_gain)
        if self._sizes is not None and self.state == "ready":
            self._sizes.take(self.mask, found, t)
        return self._in_picture(found)

    def _built(self, options: ForegroundOptions) -> PersonTemplates:
        prior = SizePrior(*(getattr(options, name) for name in SIZE_OPTIONS))
        return PersonTemplates.build(
            self._geometry, options.person_height, options.person_width, options.density, prior
        )

    def _shrunk(self, image: Image) -> Image:
        if (image.shape[1], image.shape[0]) == self._size:
            return image
        return cast(Image, cv2.resize(image, self._size, interpolation=cv2.INTER_AREA))

    def _rate(self, t: float) -> float:
        """Share of the background this picture renews: a plain mean at first, then the rate per second."""
        if self._seen in (0, GROWN_UP):
            self._last = t
            self._first = t if self._seen == 0 else t - LEARNING
        self._first += min(t - self._last, 0.0)  # a clock that was set back does not make the background younger
        elapsed = max(t - self._last, 0.0)
        self._last = t
        self._seen += 1
        return max(1.0 - math.exp(-self._options.learning_rate * elapsed), 1.0 / (2.0 * self._seen))

    def _corrected(self, image: Image, rate: float) -> Image:
        """Divide out the median change of light per channel since the background was learned."""
        sample = _sampled(image)
        if self._light is None:
            self._light = sample
            return image
        # Black and burnt-out pixels do not follow the light.
        usable = (sample > 15.0) & (sample < 240.0) & (self._light > 15.0) & (self._light < 240.0)
        ratio = np.where(usable, self._light / np.maximum(sample, 1.0), np.nan)
        counts = usable.sum(axis=(0, 1))
        gain = np.ones(3)
        for channel in np.flatnonzero(counts > 0.1 * usable[..., 0].size):
            gain[channel] = np.nanmedian(ratio[..., channel])
        self._light += np.float32(rate) * (sample - self._light)
        table = np.clip(np.arange(256)[:, None] * gain + 0.5, 0, 255).astype(np.uint8)
        return cast(Image, cv2.LUT(image, table.reshape(256, 1, 3)))

    def _cleaned(self, marked: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Drop shadows and specks, close gaps; (h, w) of 0 and 1 at the mask's size."""
        mask: Any = (marked == FOREGROUND).astype(np.uint8)
        if (mask.shape[1], mask.shape[0]) != self._mask_size:
            mask = (cv2.resize(mask * 255, self._mask_size, interpolation=cv2.INTER_AREA) > 127).astype(np.uint8)
        cleaned: Any = cv2.morphologyEx(cv2.medianBlur(mask, 3), cv2.MORPH_CLOSE, _CLOSING)
        return cast(NDArray[np.uint8], cleaned)

    def _in_picture(self, found: Detections) -> Detections:
        """Carry detections from the mask's pixels to the delivered picture's."""
        scale = self._scale
        return Detections(
            (found.feet + 0.5) * scale - 0.5, found.boxes * np.concatenate([scale, scale]), found.confidence
        )


def _sampled(image: Image) -> NDArray[np.float32]:
    return image[GAIN_STEP // 2 :: GAIN_STEP, GAIN_STEP // 2 :: GAIN_STEP].astype(np.float32)


_BUILT_FOR = ("person_height", "person_width", "picture_width", "mask_width")
_CLOSING = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 5))


def _within(width: int, height: int, widest: int) -> tuple[int, int]:
    """Return the size shrunk to at most ``widest`` pixels across."""
    if width <= widest:
        return width, height
    return widest, max(round(height * widest / width), 1)
