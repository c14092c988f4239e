"""One picture of a camera for its calibration: what may be asked on ``Keys.still``, and what is answered.

No picture ever leaves a camera process but by this query. Two locks are on it: the setting ``allow_stills`` of the
camera process, off by default, and a permission that an operator opens by name and that ends by itself.
"""

from __future__ import annotations

from typing import Literal

import msgspec

__all__ = ["Refusal", "StillAnswer", "StillQuestion"]

Refusal = Literal["", "off", "closed", "busy", "no-picture", "no-board", "not-understood"]
"""Why there is none: the setting is off; nobody opened; too soon after the last; nothing was seen yet; no checkerboard
is in the picture."""


class StillQuestion(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``open`` allows stills for some minutes, ``look`` asks for one, ``board`` for a checkerboard's corners in it."""

    do: Literal["open", "look", "board"]
    by: str = ""
    """Who asks, for the camera's log."""
    columns: int = 0
    rows: int = 0
    """Inner corners of the checkerboard."""


class StillAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """What a camera answers."""

    refusal: Refusal = ""
    words: str = ""
    """What was done, or why not, for people."""
    until: float = 0.0
    """When the permission ends, seconds since the epoch; 0: it is not open."""
    t: float = 0.0
    """When the picture was taken."""
    width: int = 0
    height: int = 0
    jpeg: bytes = b""
    corners: list[tuple[float, float]] = []
    """Pixels of the checkerboard's inner corners, row by row."""
