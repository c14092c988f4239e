"""Alerts and zones without the names of phones: for whoever may know what happened, but not to whom."""

from __future__ import annotations

from typing import TypeVar

import msgspec

from services.api.auth import Holder
from services.api.replies import ZoneReport
from shared.messages import Alert
from shared.zones import ZoneDefinition

__all__ = ["WITHHELD", "nameless", "reads_rules", "unnamed_rules"]

A = TypeVar("A", bound=Alert)
Z = TypeVar("Z", ZoneDefinition, ZoneReport)

WITHHELD = "withheld"
"""Stands for a phone that a rule names."""


def nameless(alert: A) -> A:
    """Return an alert that names no phone; place, zone and kind stay."""
    return msgspec.structs.replace(alert, device=None, other_device=None)


def reads_rules(holder: Holder) -> bool:
    """Whether somebody may know which phones a rule is about: who sees phones anyway, and who writes the rules."""
    return not holder.scopes.isdisjoint(("positions", "zones-admin"))


def unnamed_rules(zone: Z) -> Z:
    """Return a zone whose rules say how many phones they are about, and not which."""
    rules = [
        msgspec.structs.replace(rule, target=rule.target and WITHHELD, devices=[WITHHELD] * len(rule.devices))
        for rule in zone.rules
    ]
    return msgspec.structs.replace(zone, rules=rules)
