"""What zones are and what is told of them: rules of geofences, as the API keeps them and the bus carries them.

The site file's zones are where a site begins. What staff draw later is kept by the API and published as one
``ZoneSet``, which then is the whole truth: geofence and dashboard follow its newest version.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from shared.messages import AlertKind, Message

__all__ = ["Audience", "Id", "Schedule", "ZoneDefinition", "ZoneRule", "ZoneSet"]

Id = Annotated[str, Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
Clock = Annotated[str, Meta(pattern=r"^([01][0-9]|2[0-3]):[0-5][0-9]$")]
Audience = Literal["everybody", "phones", "anonymous"]


class Schedule(msgspec.Struct, frozen=True, kw_only=True):
    """When a rule holds, in the site's time zone; ``until`` before ``since`` runs past midnight."""

    days: Annotated[list[Annotated[int, Meta(ge=0, le=6)]], Meta(min_length=1, max_length=7)] = msgspec.field(
        default_factory=lambda: list(range(7))
    )
    """0 is Monday."""
    since: Clock = "00:00"
    until: Clock = "00:00"
    """The same as ``since``: all day."""


class ZoneRule(msgspec.Struct, frozen=True, kw_only=True):
    """One thing that is told of a zone, once per person (or, of crowds, per zone).

    ``limit``: dwell: seconds inside; crowd: more people than this; proximity: metres; speed: m/s; others: none.
    """

    id: Id
    kind: AlertKind
    limit: Annotated[float, Meta(gt=0.0)] | None = None
    direction: Literal["forward", "backward", "both"] = "both"
    """Of ``cross``: forward is from the left of the line to its right, as it is drawn."""
    target: Annotated[str, Meta(max_length=64)] = ""
    """Of ``proximity``: a device that is a hazard (a forklift's phone); empty: any two people."""
    audience: Audience = "everybody"
    devices: Annotated[list[Id], Meta(max_length=1000)] = []
    """Only these phones; empty: all of the audience."""
    schedule: Schedule | None = None
    confidence: Annotated[float, Meta(ge=0.5, lt=1.0)] = 0.5
    """How probable it must be that somebody is inside, or beyond the line."""
    quiet: Annotated[float, Meta(ge=0.0, le=86400.0)] = 0.0
    """Seconds for which the same is not told again of the same person."""


class ZoneDefinition(msgspec.Struct, frozen=True, kw_only=True):
    """An area with corners, or a directed line that people cross; metres on one floor."""

    id: Id
    name: Annotated[str, Meta(max_length=200)] = ""
    floor: Id
    shape: Literal["area", "line"] = "area"
    points: Annotated[list[tuple[float, float]], Meta(min_length=2, max_length=1000)]
    rules: Annotated[list[ZoneRule], Meta(max_length=50)] = []


class ZoneSet(Message, frozen=True, kw_only=True):
    """All zones of a site, from the API; ``t``: when they were changed; a version that is not newer is no news."""

    version: int
    zones: list[ZoneDefinition] = []
