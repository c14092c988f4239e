"""What the API answers about learning; the parts are those of ``shared.learning_report``."""

from __future__ import annotations

import msgspec

from services.api.replies import Reply
from shared.learning_report import (
    AccessPointFit,
    AccuracyReport,
    Activation,
    AreaLessons,
    CameraLessons,
    DeviceLessons,
    ModelKind,
)

__all__ = [
    "AccessPointOfArea",
    "AccuracyOfArea",
    "Learning",
    "LearningAccessPoints",
    "LearningAccuracy",
    "LearningCameras",
    "LearningDevices",
    "LearningDone",
    "LearningHistory",
    "RollBack",
]


class Learning(Reply, frozen=True, kw_only=True):
    """All that learning tells of itself. Without the scope positions nothing of single phones."""

    t: float
    frozen: bool
    """Whether activation is switched off by hand."""
    may_change: bool
    """Whether this key may roll back, freeze, export and import."""
    areas: list[AreaLessons]
    cameras: list[CameraLessons]
    devices: list[DeviceLessons]
    history: list[Activation]
    """The newest decisions, newest first; all of them under ``/v1/learning/history``."""


class AccessPointOfArea(Reply, frozen=True, kw_only=True):
    """One access point's fit, and of which area's radio model; ``version`` 0: as the site file says."""

    area: str
    version: int
    fit: AccessPointFit


class LearningAccessPoints(Reply, frozen=True, kw_only=True):
    """How well the active radio models explain what was heard last."""

    t: float
    access_points: list[AccessPointOfArea]


class LearningCameras(Reply, frozen=True, kw_only=True):
    """What was learned of each camera."""

    t: float
    cameras: list[CameraLessons]


class LearningDevices(Reply, frozen=True, kw_only=True):
    """What was learned of each phone; needs the scope positions too."""

    t: float
    devices: list[DeviceLessons]


class AccuracyOfArea(Reply, frozen=True, kw_only=True):
    """How far off named positions in an area are believed to be."""

    area: str
    accuracy: AccuracyReport


class LearningAccuracy(Reply, frozen=True, kw_only=True):
    """Accuracy as Atrium itself believes it, by area: from predictions of what it had not seen yet."""

    t: float
    areas: list[AccuracyOfArea]


class LearningHistory(Reply, frozen=True, kw_only=True):
    """Decisions about candidate models, newest first."""

    t: float
    history: list[Activation]
    next: float | None
    """As ``before`` it asks for the next page; null: there is none."""


class LearningDone(Reply, frozen=True, kw_only=True):
    """What was done."""

    words: str
    version: int | None = None
    """After a roll-back: of the model that is active now."""


class RollBack(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which model returns to the version before: of this kind, of this area, camera or device."""

    kind: ModelKind
    subject: str
