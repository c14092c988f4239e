"""What an answer tells of people: routes say so, and the audit layer writes it down. Nothing is read from the URL."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from starlette.requests import HTTPConnection

__all__ = ["ALL", "Seen", "saw", "saw_rows"]

FEWER_THAN = 5
"""Named people in an answer are written down one by one, more as a read of everybody."""


@dataclass(frozen=True, slots=True)
class Seen:
    """What an answer tells.

    Attributes:
        devices: whom it was asked about, or whom it names where those are few; a 404 tells of them too.
        everybody: whether it names whomever there is.
        picture: whether it shows a camera's picture, or what is in it.
        stream: what is told as long as the client stays, in words; empty: it is told once.
    """

    devices: tuple[str, ...] = ()
    everybody: bool = False
    picture: bool = False
    stream: str = ""


ALL = Seen(everybody=True)


def saw(connection: HTTPConnection, seen: Seen) -> None:
    """Say what the answer to a request tells."""
    connection.state.audit_seen = seen


def saw_rows(connection: HTTPConnection, devices: Iterable[str | None]) -> None:
    """Say whom an answer with one row for each of ``devices`` names."""
    named = sorted({device for device in devices if device is not None})
    saw(connection, ALL if len(named) >= FEWER_THAN else Seen(devices=tuple(named)))
