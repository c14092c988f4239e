"""What every person detector promises, and how a setting names one.

A detector looks at one picture after the other and says where people stand *in the picture*; ``projection`` carries
that to the floor. Foreground, head and neural detectors meet the same protocol and pass the same contract test.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Protocol, cast, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError

from shared.site import CameraGeometry

__all__ = ["Detections", "Detector", "DetectorError", "DetectorKind", "Image", "check_detector", "detector_kind"]

Image = NDArray[np.uint8]
"""One picture, (height, width, 3), blue-green-red."""


class DetectorError(ValueError):
    """The detector or its options cannot be used: the text names option, value and what is allowed."""


@dataclass(frozen=True, slots=True)
class Detections:
    """The people of one picture as parallel arrays.

    Attributes:
        feet: (n, 2) pixels where each stands on the floor.
        boxes: (n, 4) left, top, width, height in pixels; may reach beyond the picture's edge.
        confidence: (n,) in [0, 1], comparable within one detector only.
    """

    feet: NDArray[np.float64]
    boxes: NDArray[np.float64]
    confidence: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.feet)

    @classmethod
    def none(cls) -> Detections:
        """Return the detections of a picture without people."""
        return cls(np.zeros((0, 2)), np.zeros((0, 4)), np.zeros(0))


@runtime_checkable
class Detector(Protocol):
    """Finds people in the pictures of one camera; the same pictures after ``reset`` give the same detections."""

    @property
    def state(self) -> Literal["learning", "ready"]:
        """``learning`` while finding nobody does not yet mean that nobody is there."""
        ...

    def detect(self, image: Image, t: float) -> Detections:
        """Return who is in ``image`` (of the geometry's size), at ``t`` s, which falls only if a clock is set back."""
        ...

    def reset(self) -> None:
        """Forget everything seen so far."""
        ...


class DetectorKind(Protocol):
    """What a setting names: a class with a pydantic model of its options, built from a geometry and those options."""

    Options: ClassVar[type[BaseModel]]

    def __call__(self, geometry: CameraGeometry, options: Any) -> Detector:
        """Return a detector for pictures of ``geometry.image_size``."""
        ...


BUILT_IN = {"foreground": "services.camera.foreground:ForegroundDetector"}


def detector_kind(name: str) -> DetectorKind:
    """Return the detector class called ``name``: a built-in one or ``package.module:Class``.

    Raises:
        DetectorError: there is none of that name, or it is no detector.
    """
    path = BUILT_IN.get(name, name)
    module_name, colon, class_name = path.partition(":")
    if not colon:
        raise DetectorError(f"detector: {name!r} is unknown; allowed: {', '.join(BUILT_IN)} or package.module:Class")
    try:
        kind = getattr(importlib.import_module(module_name), class_name)
    except (ImportError, AttributeError) as error:
        raise DetectorError(f"detector: {name!r} cannot be imported: {error}") from error
    missing = [part for part in ("Options", "state", "detect", "reset") if not hasattr(kind, part)]
    if missing:
        raise DetectorError(f"detector: {name!r} is no detector, it lacks {', '.join(missing)}")
    return cast(DetectorKind, kind)


def check_detector(name: str, options: Mapping[str, Any]) -> tuple[DetectorKind, BaseModel]:
    """Return the detector class and its checked options.

    Raises:
        DetectorError: the class is unknown, or an option is unknown or out of range.
    """
    kind = detector_kind(name)
    try:
        return kind, kind.Options.model_validate(dict(options))
    except ValidationError as error:
        lines = []
        for problem in error.errors():
            option = ".".join(str(part) for part in problem["loc"])
            lines.append(f"detector_options.{option}: {problem['msg']} (found {problem['input']!r})")
        known = ", ".join(kind.Options.model_fields) or "none"
        raise DetectorError("\n".join(lines) + f"; options of {name!r}: {known}") from error
