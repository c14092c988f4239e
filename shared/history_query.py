"""What may be asked about the past, and how it is answered: the query ``Keys.history``.

A question is JSON; its answer is MessagePack, because a day of one device is 86 400 points: long columns travel as the
bytes of an array (``column`` and ``numbers``). Times are seconds since the epoch (UTC), lengths metres; what is asked
for is what was measured from ``since`` until just before ``until``.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from shared.messages import Alert
from shared.zones import ZoneDefinition

__all__ = [
    "FEWEST_PEOPLE",
    "GRAIN",
    "LONGEST_PERIOD",
    "LONGEST_TRAJECTORY",
    "STATES",
    "AskAlerts",
    "AskDwell",
    "AskFlows",
    "AskHeatMap",
    "AskOccupancy",
    "AskTrajectory",
    "DeviceAlerts",
    "Dwell",
    "DwellRow",
    "Flows",
    "HeatMap",
    "HistoryAnswer",
    "HistoryQuestion",
    "OccupancySeries",
    "OfPlace",
    "Refusal",
    "Trajectory",
    "column",
    "decode_answer",
    "decode_question",
    "numbers",
    "whole_grains",
]

STATES = ("confirmed", "coasting", "unseen")
"""As ``TrackState``; a trajectory holds indices."""
FEWEST_PEOPLE = 5
"""What fewer people have done is not told: it could be found out who."""
GRAIN = 900.0
"""Seconds: sums over people are of whole quarter hours. Two that differ by a second could differ by one person."""
LONGEST_TRAJECTORY = 2 * 86400.0
LONGEST_PERIOD = 31 * 86400.0 + 3600.0
"""A month of the local calendar, an hour longer where the clocks go back."""

Column: TypeAlias = bytes
"""An array of float64 or int32, little-endian."""
Whom: TypeAlias = Literal["people", "phones"]
"""Whom cameras saw, with a phone or without; or the devices, also where no camera saw them."""


class AskTrajectory(msgspec.Struct, frozen=True, kw_only=True, tag="trajectory"):
    """Where was this device? At most ``LONGEST_TRAJECTORY``."""

    device: str
    since: float
    until: float
    step: Annotated[float, Meta(ge=0.0, le=3600.0)] = 0.0
    """Seconds between two points at least; 0: all that is kept."""


class AskAlerts(msgspec.Struct, frozen=True, kw_only=True, tag="alerts"):
    """What was told of this device? For its owner: at most ``LONGEST_PERIOD``."""

    device: str
    since: float
    until: float


class AskOccupancy(msgspec.Struct, frozen=True, kw_only=True, tag="occupancy"):
    """How many people were in these zones, or areas? Times of day are the site's."""

    since: float
    until: float
    zones: list[str] = []
    """Empty: all that anything is known of."""
    of: Literal["zone", "area"] = "zone"
    step: Annotated[int, Meta(ge=60, le=86400)] = 3600
    """Seconds of one value, in whole minutes; steps begin at local midnight. 86400: local days."""


class AskHeatMap(msgspec.Struct, frozen=True, kw_only=True, tag="heatmap"):
    """Where did people stay, on one floor? As ``AskDwell`` and ``AskFlows``, in whole quarter hours."""

    floor: str
    since: float
    until: float
    cell: Annotated[float, Meta(ge=0.1, le=20.0)] = 0.5
    of: Whom = "people"


class AskDwell(msgspec.Struct, frozen=True, kw_only=True, tag="dwell"):
    """How long did people stay at each place?"""

    since: float
    until: float
    places: list[ZoneDefinition] = []
    """Such as the surroundings of exhibits; empty: the zones."""
    of: Whom = "people"
    shortest: Annotated[float, Meta(ge=0.0, le=3600.0)] = 5.0
    """Who stays for less passes by."""
    away: Annotated[float, Meta(ge=0.0, le=3600.0)] = 10.0
    """Seconds of absence that do not end a visit."""


class AskFlows(msgspec.Struct, frozen=True, kw_only=True, tag="flows"):
    """From where did people go where?"""

    since: float
    until: float
    places: list[ZoneDefinition] = []
    of: Whom = "people"
    shortest: Annotated[float, Meta(ge=0.0, le=3600.0)] = 5.0
    away: Annotated[float, Meta(ge=0.0, le=3600.0)] = 10.0
    within: Annotated[float, Meta(gt=0.0, le=86400.0)] = 600.0
    """Seconds on the way between two places at most."""


HistoryQuestion = AskTrajectory | AskAlerts | AskOccupancy | AskHeatMap | AskDwell | AskFlows


class Trajectory(msgspec.Struct, frozen=True, kw_only=True, tag="trajectory"):
    """Points of one device in the order of time, revisions applied."""

    device: str
    floors: list[str]
    """Names of the floors ``floor`` counts."""
    t: Column
    x: Column
    y: Column
    accuracy: Column
    """One sigma, m."""
    probability: Column
    """Of the device being there."""
    track: Column
    """int32; 0 where no camera saw it."""
    state: Column
    """int32, of ``STATES``."""
    floor: Column
    """int32, of ``floors``."""


class DeviceAlerts(msgspec.Struct, frozen=True, kw_only=True, tag="alerts"):
    """Alerts about one device, oldest first; none names a device."""

    alerts: list[Alert]


class OfPlace(msgspec.Struct, frozen=True, kw_only=True):
    """One place's values, one per step; None where nothing was told."""

    id: str
    people: list[float | None]
    """In the mean."""
    most: list[int | None]
    phones: list[float | None]


class OccupancySeries(msgspec.Struct, frozen=True, kw_only=True, tag="occupancy"):
    """How many people were where, by steps of the site's local time."""

    time_zone: str
    t: list[float]
    """When each step begins."""
    places: list[OfPlace]


class HeatMap(msgspec.Struct, frozen=True, kw_only=True, tag="heatmap"):
    """Seconds that people spent in each cell, by row (y) and column (x); None where fewer than five people were.

    Over several days: the sum of those days on which five people or more were in the cell.
    """

    floor: str
    origin: tuple[float, float]
    """The lower left corner of the first cell."""
    cell: float
    seconds: list[list[float | None]]
    people: list[list[int | None]]


class DwellRow(msgspec.Struct, frozen=True, kw_only=True):
    """How long people stayed at one place on the days with five people or more; all but ``id`` None where none had."""

    id: str
    people: int | None
    visits: int | None
    mean: float | None
    median: float | None
    p90: float | None
    """Seconds of a visit."""


class Dwell(msgspec.Struct, frozen=True, kw_only=True, tag="dwell"):
    """Stays, by place."""

    places: list[DwellRow]


class Flows(msgspec.Struct, frozen=True, kw_only=True, tag="flows"):
    """How often people went from the place of the row to that of the column, on the days on which five people or more
    did; None where on none."""

    zones: list[str]
    counts: list[list[int | None]]


class Refusal(msgspec.Struct, frozen=True, kw_only=True, tag="refused"):
    """Why there is no answer."""

    words: str
    field: str = ""
    """Which part of the question is to blame; empty: none, it is history's own trouble and may pass."""
    found: str = ""
    allowed: str = ""


HistoryAnswer = Trajectory | DeviceAlerts | OccupancySeries | HeatMap | Dwell | Flows | Refusal

_questions: msgspec.json.Decoder[HistoryQuestion] = msgspec.json.Decoder(HistoryQuestion)
_answers: msgspec.msgpack.Decoder[HistoryAnswer] = msgspec.msgpack.Decoder(HistoryAnswer)


def decode_question(payload: bytes) -> HistoryQuestion:
    """Return a question.

    Raises:
        msgspec.MsgspecError: it is none.
    """
    return _questions.decode(payload)


def decode_answer(payload: bytes) -> HistoryAnswer:
    """Return an answer.

    Raises:
        msgspec.MsgspecError: it is none.
    """
    return _answers.decode(payload)


def whole_grains(since: float, until: float) -> tuple[float, float]:
    """Return the whole quarter hours that hold a period; every time zone's midnight begins one."""
    return math.floor(since / GRAIN) * GRAIN, math.ceil(until / GRAIN) * GRAIN


def column(values: NDArray[Any]) -> Column:
    """Return an array as a column: whole numbers as int32, others as float64."""
    return values.astype("<i4" if np.issubdtype(values.dtype, np.integer) else "<f8").tobytes()


def numbers(column: Column, whole: bool = False) -> NDArray[Any]:
    """Return the array of a column; ``whole``: of int32."""
    return np.frombuffer(column, "<i4" if whole else "<f8")
