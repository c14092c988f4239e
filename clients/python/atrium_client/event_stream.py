"""Server-sent events: lines in, events out (WHATWG HTML, "Server-sent events", as far as Atrium uses it)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import msgspec

__all__ = ["Event", "lines", "parse"]


@dataclass(frozen=True, slots=True)
class Event:
    """One event: its kind, what it says, and its id, where it has one."""

    name: str
    data: Any
    id: str = ""


def lines(chunks: Iterable[bytes]) -> Iterator[str]:
    """Yield the lines of a stream of bytes; a line feed ends one, and nothing else that may stand in a text does."""
    rest = b""
    for chunk in chunks:
        *ended, rest = (rest + chunk).split(b"\n")
        for line in ended:
            yield line.removesuffix(b"\r").decode()


def parse(lines: Iterable[str]) -> Iterator[Event | None]:
    """Yield the events that ``lines`` hold, None for each comment: it says that the connection lives.

    Raises:
        msgspec.DecodeError: an event's data is no JSON.
    """
    name, number = "message", ""
    data: list[str] = []
    for line in lines:
        if not line:
            if data:
                yield Event(name, msgspec.json.decode("\n".join(data)), number)
            name, number, data = "message", "", []
        elif line.startswith(":"):
            yield None
        else:
            field, _, value = line.partition(":")
            value = value.removeprefix(" ")
            if field == "event":
                name = value
            elif field == "id":
                number = value
            elif field == "data":
                data.append(value)
