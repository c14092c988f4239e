"""What history keeps of the bus, as it lies in the spool and goes to the database, oldest first."""

from __future__ import annotations

from typing import Literal

import msgspec

from shared.messages import Alert

__all__ = ["AlertTold", "Counted", "Entry", "Forgotten", "Points", "Replaced", "pack", "unpack"]

Kind = Literal["track", "device"]
"""Whom a camera saw, without a name; or a device, on a track or followed by its phone alone."""


class Points(msgspec.Struct, frozen=True, kw_only=True, tag="p"):
    """Where some tracks or devices of one area were; parallel columns, metres and seconds since the epoch."""

    kind: Kind
    area: str
    step: float
    """Seconds each point stands for."""
    subject: list[str]
    """The device, or the track's number."""
    floor: list[str]
    t: list[float]
    x: list[float]
    y: list[float]
    accuracy: list[float]
    """One sigma, m."""
    probability: list[float]
    track: list[int]
    state: list[int]
    """Index into ``shared.history_query.STATES``."""


class Replaced(msgspec.Struct, frozen=True, kw_only=True, tag="r"):
    """A revision: of these devices in this area, all from ``since`` to ``until`` gives way to ``points``."""

    area: str
    device: list[str]
    since: list[float]
    until: float
    points: Points


class AlertTold(msgspec.Struct, frozen=True, kw_only=True, tag="a"):
    """An alert."""

    alert: Alert


class Counted(msgspec.Struct, frozen=True, kw_only=True, tag="c"):
    """How many people were at some places at one time; nobody by name."""

    kind: Literal["zone", "area"]
    t: float
    place: list[str]
    people: list[int]
    phones: list[int]


class Forgotten(msgspec.Struct, frozen=True, kw_only=True, tag="f"):
    """A device withdrew its consent."""

    device: str
    t: float


Entry = Points | Replaced | AlertTold | Counted | Forgotten

_encoder = msgspec.msgpack.Encoder()
_decoder: msgspec.msgpack.Decoder[Entry] = msgspec.msgpack.Decoder(Entry)


def pack(entry: Entry) -> bytes:
    """Return an entry as bytes."""
    return _encoder.encode(entry)


def unpack(payload: bytes) -> Entry:
    """Return the entry held in ``payload``.

    Raises:
        msgspec.MsgspecError: it is none.
    """
    return _decoder.decode(payload)
