"""Parts of events: those of one device, zone or place, and all but an erased device. JSON in, JSON out.

Device ids hold no character that JSON escapes, so an event whose bytes do not hold one does not name it.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
from numpy.typing import NDArray

from services.api.nameless import nameless
from services.api.replies import TrackColumns
from shared.erased import Erased
from shared.messages import Alert, Occupancy, Revision

__all__ = ["Holds", "of_device", "of_place", "of_zone", "without_device", "without_names"]

Holds = Callable[[NDArray[np.object_], NDArray[np.float64], NDArray[np.float64]], NDArray[np.bool_]]
"""Which of n points (floors; x and y in metres) lie where somebody asks for."""

_tracks = msgspec.json.Decoder(TrackColumns)
_revision = msgspec.json.Decoder(Revision)
_alert = msgspec.json.Decoder(Alert)
_occupancy = msgspec.json.Decoder(Occupancy)
_COLUMNS = tuple(field for field in TrackColumns.__struct_fields__ if field not in ("area", "t"))


def without_device(event: str, payload: bytes, device: str) -> bytes | None:
    """Return an event without an erased device; None where nothing is left of it."""
    erased = Erased()
    erased.add(device)
    if event == "tracks":
        columns = _tracks.decode(payload)
        # Whom a camera sees stays, without a name; who is followed by the device alone is gone with it.
        rows = [i for i, name in enumerate(columns.device) if name != device or columns.state[i] != "unseen"]
        gone = [columns.device[i] == device for i in rows]
        kept = _rows(columns, rows)
        return msgspec.json.encode(
            msgspec.structs.replace(
                kept,
                device=[None if was else name for was, name in zip(gone, kept.device, strict=True)],
                device_since=[None if was else t for was, t in zip(gone, kept.device_since, strict=True)],
                probability=[0.0 if was else p for was, p in zip(gone, kept.probability, strict=True)],
            )
        )
    if event == "revision":
        revision = erased.from_revision(_revision.decode(payload))
        return msgspec.json.encode(revision) if revision.device else None
    if event == "alert":
        return msgspec.json.encode(erased.from_alert(_alert.decode(payload)))
    return payload


def without_names(payload: bytes) -> bytes:
    """Return an alert as those are told it who may not know which phones it is about."""
    return msgspec.json.encode(nameless(_alert.decode(payload)))


def of_device(event: str, payload: bytes, device: str) -> bytes | None:
    """Return what an event tells of one device; None: nothing."""
    if b'"' + device.encode() + b'"' not in payload:
        return None
    if event == "tracks":
        columns = _tracks.decode(payload)
        rows = [row for row, name in enumerate(columns.device) if name == device]
        return msgspec.json.encode(_rows(columns, rows)) if rows else None
    if event == "revision":
        revision = _revision.decode(payload)
        others = Erased()
        for name in revision.device:
            if name != device:
                others.add(name)
        revision = others.from_revision(revision)
        return msgspec.json.encode(revision) if revision.device else None
    if event == "alert":
        alert = _alert.decode(payload)
        return payload if device in (alert.device, alert.other_device) else None
    return None


def of_zone(event: str, payload: bytes, told_of: str | None, zone: str) -> bytes | None:
    """Return what an event, which is ``told_of`` a zone, tells of ``zone``; None: nothing. Of people: ``of_place``."""
    if event in ("alert", "acknowledged"):
        return payload if told_of == zone else None
    if event == "occupancy" and b'"' + zone.encode() + b'"' in payload:
        counts = _occupancy.decode(payload)
        rows = [row for row, name in enumerate(counts.zone) if name == zone]
        columns = {name: [getattr(counts, name)[row] for row in rows] for name in counts.columns()}
        return msgspec.json.encode(Occupancy(t=counts.t, blind=[zone] if zone in counts.blind else [], **columns))
    return None


def of_place(event: str, payload: bytes, holds: Holds, floors: dict[str, str], quality: float) -> bytes | None:
    """Return what an event tells of a place; None: nothing. People who are not there are left out.

    Args:
        event: its name.
        payload: its JSON.
        holds: what lies there.
        floors: of areas: a revision does not tell it.
        quality: of a track at least.
    """
    if event == "tracks":
        columns = _tracks.decode(payload)
        there = holds(*_points(columns.floor, columns.x, columns.y)) & (np.asarray(columns.quality, float) >= quality)
        return payload if there.all() else msgspec.json.encode(_rows(columns, np.flatnonzero(there).tolist()))
    if event == "revision":
        revision = _revision.decode(payload)
        floor = [floors.get(revision.area, "")] * len(revision.x)
        rows = np.flatnonzero(holds(*_points(floor, revision.x, revision.y))).tolist()
        # The devices stay: one without points was nowhere here, whatever was told of it before.
        points = {name: [getattr(revision, name)[row] for row in rows] for name in revision.columns()}
        return msgspec.json.encode(msgspec.structs.replace(revision, **points))
    if event == "alert":
        alert = _alert.decode(payload)
        return payload if holds(*_points([alert.floor], [alert.x], [alert.y])).all() else None
    return None


def _points(
    floor: list[str], x: list[float], y: list[float]
) -> tuple[NDArray[np.object_], NDArray[np.float64], NDArray[np.float64]]:
    return np.array(floor, dtype=object), np.array(x, dtype=float), np.array(y, dtype=float)


def _rows(columns: TrackColumns, rows: list[int]) -> TrackColumns:
    return msgspec.structs.replace(columns, **{name: [getattr(columns, name)[i] for i in rows] for name in _COLUMNS})
