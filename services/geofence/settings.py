"""What the geofence service can be told."""

from __future__ import annotations

from pydantic import Field

from shared.settings import ServiceSettings

__all__ = ["GeofenceSettings"]


class GeofenceSettings(ServiceSettings):
    """Settings of the zone alerts. Wider margins and longer waits mean calmer, later alerts."""

    geofence_margin: float = Field(
        0.3,
        ge=0,
        le=10,
        description="metres on either side of a border in which nothing changes; deeper counts as inside at once",
    )
    geofence_min_seconds: float = Field(
        0.5, ge=0, le=60, description="seconds on the other side of a border until it counts as crossed"
    )
    geofence_grace: float = Field(
        2.0, gt=0, le=600, description="seconds after which a track that vanished inside a zone has left it"
    )
    geofence_silence: float = Field(
        10.0, gt=0, le=3600, description="seconds without any tracks of an area after which everybody has left"
    )
    geofence_history: int = Field(
        200, ge=1, le=100_000, description="alerts of each zone kept for readers that join later"
    )
