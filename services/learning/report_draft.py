"""A report while its parts are told: each learner adds what it knows of an area, a camera or a phone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

from shared.learning_report import Activation, AreaLessons, CameraLessons, DeviceLessons, LearningReport

__all__ = ["ReportDraft", "Telling"]


class ReportDraft:
    """Collects fields by area, camera and device; what nobody tells keeps its default."""

    def __init__(self) -> None:
        self._areas: dict[str, dict[str, Any]] = {}
        self._cameras: dict[str, dict[str, Any]] = {}
        self._devices: dict[str, dict[str, Any]] = {}

    def area(self, area: str, **fields: Any) -> None:
        """Tell fields of ``AreaLessons``."""
        self._areas.setdefault(area, {"area": area}).update(fields)

    def camera(self, camera: str, area: str, **fields: Any) -> None:
        """Tell fields of ``CameraLessons``."""
        self._cameras.setdefault(camera, {"camera": camera, "area": area}).update(fields)

    def camera_words(self, camera: str, area: str, words: str) -> None:
        """Add to what an operator should know of a camera; several learners may have something to say."""
        if words:
            self.camera(camera, area)
            said = self._cameras[camera].get("words", "")
            self._cameras[camera]["words"] = f"{said}; {words}" if said else words

    def device(self, device: str, **fields: Any) -> None:
        """Tell fields of ``DeviceLessons``."""
        self._devices.setdefault(device, {"device": device}).update(fields)

    def report(self, t: float, frozen: bool, history: Sequence[Activation]) -> LearningReport:
        """Return the report, everything in order of its name."""
        return LearningReport(
            t=t,
            frozen=frozen,
            areas=[AreaLessons(**fields) for _, fields in sorted(self._areas.items())],
            cameras=[CameraLessons(**fields) for _, fields in sorted(self._cameras.items())],
            devices=[DeviceLessons(**fields) for _, fields in sorted(self._devices.items())],
            history=list(history),
        )


@runtime_checkable
class Telling(Protocol):
    """A learner, judge or map that has something to tell; none has to."""

    def tell(self, draft: ReportDraft) -> None:
        """Add to the report what is known now."""
        ...
