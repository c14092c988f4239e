"""Times as clients say them: seconds since the epoch, or RFC 3339."""

from __future__ import annotations

import datetime
import re
from typing import Annotated, Any

from pydantic import AllowInfNan, BeforeValidator, WithJsonSchema

__all__ = ["TIME", "YEAR_9999", "Time", "seconds_of"]

TIME = "seconds since the epoch (UTC) such as 1767225600.0, or RFC 3339 such as 2026-01-01T00:00:00Z"

YEAR_9999 = 253_370_764_800.0
"""Seconds since the epoch at which it begins: calendars do not go on."""


def seconds_of(told: Any) -> Any:
    """Return an RFC 3339 time as seconds since the epoch; anything else as it is.

    Raises:
        ValueError: it looks like a time and is none, or does not say of which time zone.
    """
    if not isinstance(told, str) or not re.match(r"\d{4}-\d\d-\d\d[Tt ]", told):
        return told
    # A plus sign that nobody escaped arrives as a space.
    when = datetime.datetime.fromisoformat(re.sub(r" (?=\d\d:\d\d$)", "+", told[:19].replace(" ", "T") + told[19:]))
    if when.tzinfo is None:
        raise ValueError("a time without a zone")
    return when.timestamp()


Time = Annotated[
    float,
    AllowInfNan(False),
    BeforeValidator(seconds_of),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string", "format": "date-time"}]}),
]
"""Of a query."""
