"""What the API answers about what it keeps itself."""

from __future__ import annotations

from services.api.replies import Reply

__all__ = ["Exhibit", "Exhibits"]


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
