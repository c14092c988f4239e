"""Reads Atrium's API: who is where, what happened, what is in front of this visitor."""

from atrium_client.client import AtriumClient
from atrium_client.errors import AtriumError, Conflict, NotAllowed, NotFound, TryLater
from atrium_client.event_stream import Event
from atrium_client.models import (
    Alert,
    Device,
    DwellAtPlace,
    DwellReport,
    Exhibit,
    ExhibitInFront,
    Flows,
    HeatMap,
    InFront,
    Occupancy,
    OccupancyOfPlace,
    Position,
    Rule,
    Schedule,
    SignedIn,
    Track,
    Trajectory,
    Zone,
)

__all__ = [
    "Alert",
    "AtriumClient",
    "AtriumError",
    "Conflict",
    "Device",
    "DwellAtPlace",
    "DwellReport",
    "Event",
    "Exhibit",
    "ExhibitInFront",
    "Flows",
    "HeatMap",
    "InFront",
    "NotAllowed",
    "NotFound",
    "Occupancy",
    "OccupancyOfPlace",
    "Position",
    "Rule",
    "Schedule",
    "SignedIn",
    "Track",
    "Trajectory",
    "TryLater",
    "Zone",
]
