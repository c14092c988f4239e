"""Server-sent events as bytes: reading them from the API, writing them to browsers (WHATWG HTML §9.2)."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Event", "EventReader", "StreamError", "written"]

LARGEST_EVENT = 8 * 2**20


class StreamError(ValueError):
    """What arrives is no event stream a dashboard could show."""


@dataclass(frozen=True, slots=True)
class Event:
    """One event: its name and its data, as received."""

    name: str
    data: bytes


class EventReader:
    """Cuts a stream of bytes into events, wherever the network cut it before."""

    def __init__(self) -> None:
        self._rest = b""
        self._name = ""
        self._data: list[bytes] = []
        self._size = 0

    def feed(self, chunk: bytes) -> list[Event]:
        """Return the events that ``chunk`` completes. Comments and unknown fields are skipped.

        Only line feeds (and the carriage return before one) end a line here: text may hold any other separator.

        Raises:
            StreamError: an event grows past 8 MiB.
        """
        *lines, self._rest = (self._rest + chunk).split(b"\n")
        events = []
        for raw in lines:
            event = self._line(raw.removesuffix(b"\r"))
            if event is not None:
                events.append(event)
        if self._size + len(self._rest) > LARGEST_EVENT:
            raise StreamError(f"an event of more than {LARGEST_EVENT // 2**20} MiB")
        return events

    def _line(self, line: bytes) -> Event | None:
        if not line:
            event = Event(self._name or "message", b"\n".join(self._data)) if self._data else None
            self._name, self._data, self._size = "", [], 0
            return event
        field, _, value = line.partition(b":")
        value = value.removeprefix(b" ")
        if field == b"event":
            self._name = value.decode("utf-8", "replace")
        elif field == b"data":
            self._data.append(value)
            self._size += len(value)
        return None


def written(name: str, data: bytes) -> bytes:
    """Return the event as it travels; ``data`` is JSON, in which a raw line feed is only white space."""
    return b"event: " + name.encode() + b"\ndata: " + data.replace(b"\n", b"\ndata: ") + b"\n\n"
