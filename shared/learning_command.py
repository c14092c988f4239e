"""What learning can be told to do, and what it answers: payloads of the query ``learning/command``, JSON."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from shared.learning_report import Activation, MapGrid, ModelKind

__all__ = ["LearningAnswer", "LearningCommand", "MapKind", "ModelLine"]

MapKind = Literal["visits", "occlusion", "radio", "shadowing", "magnetic"]


class LearningCommand(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One order. What an order does not need stays as it is."""

    do: Literal["list", "activate", "rollback", "freeze", "unfreeze", "export", "import", "map", "history"]
    by: str = ""
    """Who asked: the name of a key, for log and history."""
    kind: ModelKind | None = None
    subject: str | None = None
    """``rollback``: the model of this kind of this area, camera or device returns to the version before;
    ``activate``: its ``version`` goes live without being tried; ``history``: only of this kind and subject."""
    version: int | None = None
    area: str | None = None
    map: MapKind | None = None
    access_point: str | None = None
    """``map``: this map of this area; ``radio`` and ``shadowing`` are of one access point."""
    bundle: msgspec.Raw = msgspec.Raw(b"null")
    """``import``: what an ``export`` answered, here or in another museum."""
    as_site: bool = False
    """``import``: models of another site are taken for this one's."""
    areas: dict[str, str] = {}
    """``import``: by area of the bundle, the area here."""
    cameras: dict[str, str] = {}
    """``import``: by camera of the bundle, the camera here."""
    force: bool = False
    """``import``: models go live at once, untried."""
    personal: bool = False
    """``export``, ``history``: models of people's phones too."""
    before: float | None = None
    most: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 100
    """``history``: decisions older than this, at most so many, but never half of those of one moment."""


class ModelLine(msgspec.Struct, frozen=True, kw_only=True):
    """One stored model, as ``list`` tells it."""

    kind: ModelKind
    subject: str
    version: int
    state: str
    t: float
    probation: bool = False
    reason: str = ""


class LearningAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """What came of an order."""

    done: bool
    words: str = ""
    """What was done or why not, for a person."""
    field: str | None = None
    """Of the order, where one of its values is to blame."""
    unknown: bool = False
    """Whether that value names nothing there is."""
    version: int | None = None
    """``rollback``, ``activate``: of the model that is active now."""
    models: list[ModelLine] = []
    """``list``: all that are stored, by kind and subject, newest first."""
    bundle: msgspec.Raw = msgspec.Raw(b"null")
    """``export``: all models."""
    history: list[Activation] = []
    """``history``: decisions, newest first."""
    older: bool = False
    """``history``: whether there are more before them."""
    map: MapGrid | None = None
    """``map``: the grid; None where nothing is learned yet, ``words`` says so."""
