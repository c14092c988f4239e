"""What geofence keeps across restarts: the zones it watched, who is inside of them, and what was told."""

from __future__ import annotations

from typing import Any

import msgspec

from shared.zones import ZoneDefinition

__all__ = ["FORMAT", "SavedState", "SavedStateError", "read_state", "write_state"]

FORMAT = "atrium-geofence-state/2"


class SavedStateError(ValueError):
    """What was saved cannot be used: the text says why."""


class SavedState(msgspec.Struct, frozen=True, kw_only=True):
    """One saved state.

    Attributes:
        site: of which site.
        version: of the zone set; 0: the site file's zones.
        zones: as they were watched.
        watch: of ``Watch.state``.
    """

    format: str
    site: str
    version: int
    zones: list[ZoneDefinition]
    watch: dict[str, Any]


def write_state(state: SavedState) -> bytes:
    """Return the state as MessagePack."""
    return msgspec.msgpack.encode(state)


def read_state(data: bytes, site: str) -> SavedState:
    """Return what ``write_state`` wrote.

    Raises:
        SavedStateError: it is no such state, or another site's.
    """
    try:
        state = msgspec.msgpack.decode(data, type=SavedState)
    except (msgspec.DecodeError, ValueError, RecursionError) as error:
        raise SavedStateError(f"it is not a state of geofence: {error}") from error
    if state.format != FORMAT:
        raise SavedStateError(f"its format is {state.format!r}, not {FORMAT!r}")
    if state.site != site:
        raise SavedStateError(f"it is of site {state.site!r}, not {site!r}")
    return state
