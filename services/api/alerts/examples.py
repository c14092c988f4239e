"""One example for each body of alerts and webhooks, shown by the OpenAPI document."""

from __future__ import annotations

from typing import Any

import msgspec

from services.api.alerts.alert_replies import Alerts, InboxAlert
from services.api.alerts.webhook_replies import DeadLetters, NewWebhook, Replayed, Webhook, Webhooks

__all__ = ["ALERT_EXAMPLES"]

_TOLD: dict[str, Any] = {
    "t": 1767225598.1,
    "id": "605d049a-1",
    "zone": "entrance",
    "kind": "enter",
    "area": "hall",
    "track": 12,
    "floor": "ground",
    "x": 9.1,
    "y": 0.4,
    "device": "d-7f3a",
    "rule": "",
    "value": None,
    "limit": None,
    "direction": None,
    "other_track": None,
    "other_device": None,
}
_SEEN: dict[str, Any] = {**_TOLD, "acknowledged": {"by": "control-room", "at": 1767225610.0, "note": "a school class"}}
_WEBHOOK: dict[str, Any] = {
    "id": "wh-5f1c0a9e77aa01b2",
    "url": "https://alarm.example.org/atrium",
    "name": "Control room",
    "kinds": ["cross", "crowd"],
    "zones": ["entrance"],
    "enabled": True,
    "created": 1767225000.0,
    "created_by": "office",
    "waiting": 1,
    "dead": 0,
    "delivered": 57,
    "failed": 2,
    "last_success": 1767225590.0,
    "last_failure": 1767225598.4,
    "last_reason": "answered 503",
}

ALERT_EXAMPLES: dict[type[msgspec.Struct], dict[str, Any]] = {
    Alerts: {"t": 1767225600.28, "alerts": [_SEEN], "next": None},
    InboxAlert: _SEEN,
    Webhook: _WEBHOOK,
    NewWebhook: {**_WEBHOOK, "secret": "whsec_C2FVsBQIhrscChlQIMV+b5sSYspob7oD"},
    Webhooks: {"t": 1767225600.28, "webhooks": [_WEBHOOK]},
    DeadLetters: {
        "t": 1767225600.28,
        "dead": [{"id": 12, "alert": _TOLD, "attempts": 12, "died": 1767225590.0, "reason": "answered 500"}],
        "next": None,
    },
    Replayed: {"replayed": 1},
}
