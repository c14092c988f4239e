"""What other people's programs are answered."""

from __future__ import annotations

import msgspec

from services.gateway.protocol import Accepted, ErrorReply

__all__ = ["AdapterReply", "Find3Error", "Find3Reply"]


class AdapterReply(msgspec.Struct, frozen=True, kw_only=True):
    """Reply 200 or 202 to a push: what became of it. What was accepted is on the bus."""

    duplicate: bool
    """True where the same push had been accepted before; nothing was published again."""
    received: float
    """Server clock when the request arrived."""
    late: bool = False
    """True, and status 202: it came too long after it was measured to count for the live position."""
    accepted: Accepted = Accepted()
    ignored: dict[str, int] = {}
    """What was not used, counted by reason."""


class Find3Reply(msgspec.Struct, frozen=True, kw_only=True):
    """What FIND3's programs expect as an answer."""

    success: bool
    message: str


class Find3Error(ErrorReply, frozen=True, kw_only=True):
    """An error as FIND3's programs show it, and as all others are told it."""

    message: str
    success: bool = False
