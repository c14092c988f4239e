"""Alerts without the names of phones: for whoever may know what happened, but not to whom."""

from __future__ import annotations

from typing import TypeVar

import msgspec

from shared.messages import Alert

__all__ = ["nameless"]

A = TypeVar("A", bound=Alert)


def nameless(alert: A) -> A:
    """Return an alert that names no phone; place, zone and kind stay."""
    return msgspec.structs.replace(alert, device=None, other_device=None)
