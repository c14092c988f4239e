"""What clients say and the API answers of webhooks: one Struct per body."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from services.api.replies import Reply
from services.api.trouble import Trouble
from shared.messages import Alert, AlertKind
from shared.zones import Id

__all__ = [
    "DeadLetter",
    "DeadLetters",
    "NewWebhook",
    "Replayed",
    "Webhook",
    "WebhookDefinition",
    "WebhookMessage",
    "Webhooks",
]


WebhookKind = Literal[AlertKind, "trouble", "recovered"]
"""Kinds of alerts, and technical trouble: it begins, it is over."""


class WebhookDefinition(msgspec.Struct, frozen=True, kw_only=True):
    """Whom to send which alerts."""

    url: Annotated[str, Meta(max_length=2000)]
    """https; http only into networks that the setting ``webhook_networks`` allows."""
    name: Annotated[str, Meta(max_length=200)] = ""
    kinds: Annotated[list[WebhookKind], Meta(max_length=20)] = []
    """Only these kinds; empty: all alerts. Technical trouble, of whatever zones, only where it is named."""
    zones: Annotated[list[Id], Meta(max_length=1000)] = []
    """Only of these zones; empty: of all."""
    enabled: bool = True
    """While false alerts are not kept for it."""


class Webhook(Reply, frozen=True, kw_only=True):
    """One webhook and how it is doing; its secret is told once, when it is made."""

    id: str
    url: str
    name: str
    kinds: list[WebhookKind]
    zones: list[str]
    enabled: bool
    created: float
    created_by: str
    """The name of the key."""
    waiting: int
    """Alerts yet to be taken."""
    dead: int
    """Alerts given up."""
    delivered: int
    failed: int
    """Attempts."""
    last_success: float | None
    last_failure: float | None
    last_reason: str
    """Why the last attempt failed."""


class NewWebhook(Webhook, frozen=True, kw_only=True):
    """A webhook that was just made, with the secret its messages are signed with: it is told only now."""

    secret: str


class Webhooks(Reply, frozen=True, kw_only=True):
    """All webhooks."""

    t: float
    webhooks: list[Webhook]


class DeadLetter(Reply, frozen=True, kw_only=True):
    """An alert or trouble that a webhook never took."""

    id: int
    alert: Alert | None = None
    trouble: Trouble | None = None
    attempts: int
    died: float
    reason: str


class DeadLetters(Reply, frozen=True, kw_only=True):
    """What a webhook never took, oldest first."""

    t: float
    dead: list[DeadLetter]
    next: int | None
    """Where there are more: ask again with ``after`` of this."""


class Replayed(Reply, frozen=True, kw_only=True):
    """How many dead letters are sent again."""

    replayed: int


class WebhookMessage(Reply, frozen=True, kw_only=True, omit_defaults=True):
    """What a webhook is sent: an alert or trouble; ``id`` stays the same when it is sent again."""

    id: str
    site: str
    alert: Alert | None = None
    trouble: Trouble | None = None
