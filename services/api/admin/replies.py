"""What the API answers about what it keeps itself."""

from __future__ import annotations

from services.api.replies import PositionState, Reply

__all__ = ["Exhibit", "ExhibitInFront", "Exhibits", "ExhibitsInFront"]


class Exhibit(Reply, frozen=True, kw_only=True):
    """Something to look at: where it stands, and from how far and from where it is looked at."""

    id: str
    name: str
    floor: str
    x: float
    y: float
    reach: float
    facing: float | None
    etag: str
    """For ``If-Match`` of a change."""


class Exhibits(Reply, frozen=True, kw_only=True):
    """The exhibits of the site."""

    t: float
    exhibits: list[Exhibit]


class ExhibitInFront(Reply, frozen=True, kw_only=True):
    """One exhibit that a visitor may be looking at."""

    id: str
    name: str
    distance: float
    """Metres."""
    bearing: float | None
    """Degrees left of how the visitor walked last; null where nobody knows that."""
    probability: float
    """Of its being what they look at."""


class ExhibitsInFront(Reply, frozen=True, kw_only=True):
    """What one visitor may be looking at, the most probable first; what is left to 1 is nothing at all."""

    t: float
    device: str
    floor: str
    x: float
    y: float
    age: float
    state: PositionState
    heading: float | None
    """How they walked last: degrees counter-clockwise from the plan's +x axis; null: they have not walked."""
    heading_age: float | None
    """Seconds since they walked."""
    exhibits: list[ExhibitInFront]
