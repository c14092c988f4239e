"""Reads Atrium's API: who is where, what happened, what is in front of this visitor."""

from atrium_client.client import AtriumClient
from atrium_client.errors import AtriumError, Conflict, NotAllowed, NotFound, TryLater
from atrium_client.event_stream import Event
from atrium_client.models import (
    Alert,
    Device,
    Exhibit,
    ExhibitInFront,
    InFront,
    Position,
    Rule,
    Schedule,
    SignedIn,
    Track,
    Zone,
)

__all__ = [
    "Alert",
    "AtriumClient",
    "AtriumError",
    "Conflict",
    "Device",
    "Event",
    "Exhibit",
    "ExhibitInFront",
    "InFront",
    "NotAllowed",
    "NotFound",
    "Position",
    "Rule",
    "Schedule",
    "SignedIn",
    "Track",
    "TryLater",
    "Zone",
]
