"""Ending a phone's consent for a visitor who asks staff: the query ``Keys.withdrawal``, from the API to the gateway.

The gateway does what the visitor's own app would have it do: tokens die, and every store is told to forget.
"""

from __future__ import annotations

from typing import Literal

import msgspec

__all__ = ["WithdrawalAnswer", "WithdrawalOrder"]


class WithdrawalOrder(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Forget this device."""

    device: str
    by: str
    """Who of the staff, for the gateway's log."""


class WithdrawalAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """What came of it: ``withdrawn`` now or before, ``unknown``: never enrolled here, ``away``: not now, ask again."""

    outcome: Literal["withdrawn", "unknown", "away", "not-understood"]
    t: float = 0.0
    """When the consent ended, seconds since the epoch."""
    words: str = ""
    """Why it was not done."""
