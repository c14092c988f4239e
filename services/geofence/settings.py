"""What the geofence service can be told."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from shared.kept import Kept, state_on_disk
from shared.settings import ServiceSettings

__all__ = ["GeofenceSettings"]


class GeofenceSettings(ServiceSettings):
    """Settings of the zone alerts. Wider margins and longer waits mean calmer, later alerts."""

    geofence_margin: float = Field(
        0.25, ge=0, le=2, description="metres outside of a border in which somebody inside is not taken to have left"
    )
    geofence_min_seconds: float = Field(
        0.2,
        ge=0,
        le=60,
        description="seconds for which somebody must surely be across a border; who may be is waited for longer",
    )
    geofence_grace: float = Field(
        2.0, gt=0, le=600, description="seconds after which a track that vanished inside a zone has left it"
    )
    geofence_silence: float = Field(
        10.0, gt=0, le=3600, description="seconds without any tracks of an area after which nobody knows who is there"
    )
    geofence_history: int = Field(
        200, ge=1, le=100_000, description="alerts of each zone kept for readers that join later"
    )
    geofence_occupancy_every: float = Field(
        2.0, gt=0, le=3600, description="seconds between two counts of the people in every zone"
    )
    state_folder: Path | None = Field(
        None, description="where it is kept across restarts who is inside of what and what was told"
    )
    state_every: float = Field(5.0, gt=0.0, le=3600.0, description="seconds between two saved states")

    def kept(self) -> list[Kept]:
        """What geofence keeps of people."""
        rows = [
            Kept(what="who is in which zone, since when, and what was told of it", note="in memory, until they left"),
            Kept(
                what="the newest alerts of each zone, for who joins later",
                settings=("geofence_history",),
                note="in memory, until newer ones take their place or the process ends",
            ),
        ]
        if self.state_folder is not None:
            rows.append(state_on_disk("who is in which zone, on disk, for a restart", self.state_every))
        return rows
