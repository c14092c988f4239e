"""What the API answers of alerts: one Struct per body."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from services.api.replies import Reply
from shared.messages import Alert

__all__ = ["Acknowledged", "Acknowledgement", "Alerts", "InboxAlert", "Note"]


class Acknowledgement(Reply, frozen=True, kw_only=True):
    """Who looked at an alert, when, and what they said of it."""

    by: str
    """The name of the key."""
    at: float
    note: str


class InboxAlert(Alert, frozen=True, kw_only=True):
    """An alert and whether somebody has looked at it."""

    acknowledged: Acknowledgement | None = None


class Alerts(Reply, frozen=True, kw_only=True):
    """Alerts, newest first; with ``after`` in the order they came."""

    t: float
    alerts: list[InboxAlert]
    next: str | None = None
    """Where there are more: what to ask for next, with ``before`` (with ``after``, if you asked with that)."""


class Acknowledged(Reply, frozen=True, kw_only=True):
    """Somebody has looked at the alert ``id``; what the stream tells of it."""

    id: str
    acknowledged: Acknowledgement


class Note(msgspec.Struct, frozen=True, kw_only=True):
    """What somebody says who acknowledges an alert."""

    note: Annotated[str, Meta(max_length=2000)] = ""
