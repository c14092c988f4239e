"""What learning tells of itself: the answer to the query ``learning/report``, the same for the API and its readers.

Metres, dBm, dB, seconds since the epoch. NaN cannot travel: what is not known is None.
"""

from __future__ import annotations

from typing import Literal

import msgspec

__all__ = [
    "AccessPointFit",
    "AccessPointState",
    "AccuracyReport",
    "Activation",
    "AreaLessons",
    "CameraLessons",
    "DeviceLessons",
    "LearningReport",
    "MapGrid",
    "ModelKind",
    "TrackLessons",
]

ModelKind = Literal["radio", "detector", "stride", "heading", "alignment"]


AccessPointState = Literal["fine", "few readings", "changed", "moved", "silent", "not placed"]


class AccessPointFit(msgspec.Struct, frozen=True, kw_only=True):
    """What was learned of one access point, and how well the active model explains the last readings of it."""

    access_point: str
    power_1m: float
    path_loss_exponent: float
    sigma: float | None = None
    """Robust standard deviation of the last readings about the *active* model, dB; None of one it does not place."""
    bias: float | None = None
    """Their median, dB: heard minus expected."""
    readings: int = 0
    """The last ones; of one that the active model does not place all that may help to find it."""
    state: AccessPointState = "few readings"
    position: tuple[float, float, float] | None = None
    """Where the readings put it; None while they do not tell."""
    position_error: float | None = None
    """Standard deviation of that, metres."""
    words: str = ""
    """What an operator should know, in plain words."""


class TrackLessons(msgspec.Struct, frozen=True, kw_only=True):
    """How many of the last stretches were good enough to teach, and why the others were not."""

    good: int = 0
    refused: dict[str, int] = {}
    """Count by reason in plain words."""
    threshold: float | None = None
    """Least quality per second."""
    quality: float | None = None
    """Median of the good ones, nats per second."""


class AccuracyReport(msgspec.Struct, frozen=True, kw_only=True):
    """How far off Atrium believes its named positions to be, from predictions of what it had not seen yet."""

    rms: float | None = None
    p50: float | None = None
    p90: float | None = None
    named: float | None = None
    """Share of the time in which phones that are heard had a name on a track."""
    right: float | None = None
    """Share of those names believed right."""
    seconds: float = 0.0
    """Of named time it rests on."""


class AreaLessons(msgspec.Struct, frozen=True, kw_only=True):
    """One area."""

    area: str
    version: int = 0
    """Of the active radio model; 0: as the site file says."""
    access_points: list[AccessPointFit] = []
    tracks: TrackLessons = TrackLessons()
    accuracy: AccuracyReport = AccuracyReport()
    words: str = ""
    """What learning is doing or waiting for here."""


class CameraLessons(msgspec.Struct, frozen=True, kw_only=True):
    """One camera."""

    camera: str
    area: str
    version: int = 0
    options: dict[str, float] = {}
    score_t: list[float] = []
    score: list[float] = []
    """Quality per second of the tracks it feeds, over time."""
    alignment: Literal["unknown", "fine", "doubtful", "knocked", "corrected"] = "unknown"
    offset: float | None = None
    """Metres by which its positions differ from what the others say."""
    clock: float | None = None
    """Seconds by which its pictures are later than phones' steps say; negative: earlier."""
    clock_error: float | None = None
    words: str = ""


class DeviceLessons(msgspec.Struct, frozen=True, kw_only=True):
    """One phone, by its random id."""

    device: str
    slope: float | None = None
    offset: float | None = None
    """Of the line length = slope x cadence + offset, m per step/s and m."""
    r2: float | None = None
    steps: int = 0
    used: bool = False
    """Whether the line is in use."""
    heading_bias: float | None = None
    heading_error: float | None = None
    """Radians."""
    radio_offset: float | None = None
    """dB by which it hears more than others."""


class Activation(msgspec.Struct, frozen=True, kw_only=True):
    """One decision about one candidate model."""

    t: float
    kind: ModelKind
    subject: str
    version: int
    """Of the candidate; what was refused has one too."""
    decision: Literal["activated", "refused", "rolled back", "imported"]
    reason: str
    gain: float | None = None
    """Nats per withheld reading, candidate minus active."""
    margin: float | None = None
    """What it had to gain."""
    evidence: dict[str, float] = {}
    by: Literal["learning", "operator"] = "learning"


class LearningReport(msgspec.Struct, frozen=True, kw_only=True):
    """Everything at once."""

    t: float
    frozen: bool = False
    """Whether activation is switched off by hand."""
    areas: list[AreaLessons] = []
    cameras: list[CameraLessons] = []
    devices: list[DeviceLessons] = []
    history: list[Activation] = []
    """Newest first."""


class MapGrid(msgspec.Struct, frozen=True, kw_only=True):
    """A learned map of an area, as a grid: occlusion (visits), radio of one access point, magnetic field."""

    area: str
    kind: Literal["visits", "occlusion", "radio", "shadowing", "magnetic"]
    subject: str = ""
    """The access point, where there is one."""
    unit: str
    origin: tuple[float, float]
    """Centre of the first cell, metres."""
    cell: float
    rows: list[list[float | None]]
    """By row (y) and column (x); None where nothing is known."""
