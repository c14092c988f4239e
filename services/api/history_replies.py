"""What the API answers about the past; the parts are those of ``shared.history_query``."""

from __future__ import annotations

from services.api.replies import Reply
from shared.history_query import DwellRow, OfPlace
from shared.messages import TrackState

__all__ = ["DwellReport", "FlowReport", "HeatMapReport", "OccupancyReport", "TrajectoryReport"]


class TrajectoryReport(Reply, frozen=True, kw_only=True):
    """Where a device was, as is known now: revisions are applied. Parallel columns, oldest first."""

    device: str
    since: float
    until: float
    t: list[float]
    floor: list[str]
    x: list[float]
    y: list[float]
    accuracy: list[float]
    """One sigma, m."""
    probability: list[float]
    """Of the device being there."""
    track: list[int]
    """0 where no camera saw it."""
    state: list[TrackState]


class OccupancyReport(Reply, frozen=True, kw_only=True):
    """How many people were where, by steps of the site's local time; null where nothing was counted."""

    since: float
    until: float
    step: int
    time_zone: str
    t: list[float]
    """When each step begins."""
    places: list[OfPlace]


class HeatMapReport(Reply, frozen=True, kw_only=True):
    """Seconds people spent in each cell of a floor, rows go up (y); null where on no day five people were."""

    floor: str
    since: float
    until: float
    origin: tuple[float, float]
    """The lower left corner of the first cell."""
    cell: float
    seconds: list[list[float | None]]
    people: list[list[int | None]]


class DwellReport(Reply, frozen=True, kw_only=True):
    """How long people stayed at each place; null where on no day there were five people."""

    since: float
    until: float
    places: list[DwellRow]


class FlowReport(Reply, frozen=True, kw_only=True):
    """How often people went from the row's place to the column's next; null where on no day five people did."""

    since: float
    until: float
    zones: list[str]
    counts: list[list[int | None]]
