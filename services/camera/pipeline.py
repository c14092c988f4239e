"""From one picture to one message: detector and projection of one camera, built for the size its pictures have."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from services.camera.detector import Detector, Image, check_detector
from services.camera.projection import GroundDetections, Projection
from shared.messages import DetectionFrame, pack_covariances
from shared.site import Camera, CameraGeometry

__all__ = ["Pipeline", "to_message"]

STRETCH = 0.02
"""How far, as a share, the picture's proportions may differ from the calibration's before positions are doubtful."""


class Pipeline:
    """Finds the people of one camera on the floor, picture by picture.

    Args:
        camera: as the site file says.
        detector: a built-in detector or ``package.module:Class``.
        options: the detector's.

    Raises:
        DetectorError: the detector or an option is not usable.
        GeometryError: the calibration is not usable.
    """

    def __init__(self, camera: Camera, detector: str = "foreground", options: Mapping[str, Any] | None = None) -> None:
        self._camera = camera
        self._geometry: CameraGeometry = camera.geometry.build()
        self._name, self._configured = detector, dict(options or {})
        self._kind, self._options = check_detector(detector, self._configured)
        self._size: tuple[int, int] | None = None
        self._detector: Detector | None = None
        self._projection: Projection | None = None
        self._sizes_paused = False

    @property
    def state(self) -> Literal["learning", "ready"]:
        """The detector's state, for operators; ``learning`` before the first picture."""
        return "learning" if self._detector is None else self._detector.state

    @property
    def options(self) -> dict[str, float]:
        """The detector's options in use that are numbers, by name."""
        told = self._options.model_dump()
        return {name: float(value) for name, value in told.items() if isinstance(value, int | float)}

    @property
    def learned_sizes(self) -> dict[str, float]:
        """How tall and wide people were seen to be, as options; empty while too few walked, or it cannot tell."""
        return dict(getattr(self._detector, "learned_sizes", {}))

    @property
    def doubt(self) -> str:
        """Why positions may be wrong, in plain words; empty when there is no reason."""
        if self._size is None:
            return ""
        (width, height), (expected_width, expected_height) = self._size, self._geometry.image_size
        if abs(width * expected_height / (height * expected_width) - 1.0) <= STRETCH:
            return ""
        return (
            f"pictures are {width} x {height}, the calibration is for {expected_width} x {expected_height}: "
            "the proportions differ, positions will be wrong"
        )

    def process(self, image: Image, t: float) -> GroundDetections:
        """Return who stands where in ``image`` (height, width, 3), taken at ``t`` s; sizes may change on the way."""
        detector, projection = self._build(image)
        return projection.to_floor(detector.detect(image, t))

    def _build(self, image: Image) -> tuple[Detector, Projection]:
        """Return what works on pictures of this size."""
        size = (image.shape[1], image.shape[0])
        if self._detector is None or self._projection is None or size != self._size:
            self._size = size
            self._projection = Projection(self._geometry, size, self._camera.area_of_interest)
            self._detector = self._kind(self._projection.geometry, self._options)
            if self._sizes_paused:
                self.forget_sizes(paused=True)
        return self._detector, self._projection

    def adopt(self, options: Mapping[str, Any]) -> None:
        """Go on with other options; those not named keep their configured value.

        The background is kept where the detector knows how to; else it begins anew.

        Raises:
            DetectorError: an option is unknown or out of range; nothing has changed.
        """
        _, wanted = check_detector(self._name, {**self._configured, **options})
        if wanted == self._options:
            return
        self._options = wanted
        adopt = getattr(self._detector, "adopt", None)
        if self._detector is not None and not (adopt is not None and adopt(wanted)):
            self._detector = None

    def recalibrate(self, camera: Camera) -> None:
        """Go on with another calibration and area of interest of the same camera, and with the background as learned.

        Raises:
            GeometryError: the calibration is not usable; nothing has changed.
        """
        self._geometry = camera.geometry.build()
        self._camera = camera
        if self._size is None:
            return
        self._projection = Projection(self._geometry, self._size, camera.area_of_interest)
        recalibrate = getattr(self._detector, "recalibrate", None)
        if recalibrate is None:
            self._detector = None
        else:
            recalibrate(self._projection.geometry)

    def prime(self, empty: Image) -> None:
        """Begin with a picture of the scene without people, of the size of the pictures to come.

        A detector that cannot use it begins cold.
        """
        self._build(empty)
        prime = getattr(self._detector, "prime", None)
        if prime is not None:
            prime(empty)

    def forget_sizes(self, *, paused: bool = False) -> None:
        """Forget how tall and wide people are: the camera looks elsewhere. They are measured anew unless ``paused``."""
        self._sizes_paused = paused
        forget = getattr(self._detector, "forget_sizes", None)
        if forget is not None:
            forget(paused=paused)

    def reset(self) -> None:
        """Forget what was seen: the next picture does not follow the last one."""
        if self._detector is not None:
            self._detector.reset()


def to_message(camera: str, floor: str, seq: int, t: float, found: GroundDetections) -> DetectionFrame:
    """Return the detections as the bus carries them."""
    boxes: list[tuple[float, float, float, float]] = [tuple(box) for box in found.boxes.tolist()]
    return DetectionFrame(
        t=t,
        camera=camera,
        floor=floor,
        seq=seq,
        x=found.positions[:, 0].tolist(),
        y=found.positions[:, 1].tolist(),
        covariance=pack_covariances(found.covariances),
        confidence=found.confidence.tolist(),
        box=boxes,
    )
