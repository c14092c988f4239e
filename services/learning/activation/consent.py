"""Is it known who withdrew since a document was written? Only then may it bring phones' models back."""

from __future__ import annotations

import msgspec

from services.learning.activation.bundle import Bundle
from services.learning.activation.states import KEPT

__all__ = ["KEPT_DAYS", "told_of_since"]

KEPT_DAYS = round(KEPT / 86400.0)
"""Days for which the gateway tells of a withdrawal; before that nobody knows."""


def told_of_since(document: bytes, now: float) -> bool:
    """Whether all who withdrew since a document of models was written are known: it is no older than that.

    One from the future is no younger for that: a clock was wrong, there or here.

    Raises:
        msgspec.DecodeError: it is no such document.
    """
    return abs(now - msgspec.json.decode(document, type=Bundle).t) <= KEPT
