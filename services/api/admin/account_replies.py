"""What is asked and answered about keys, staff, sign-ins and the audit log."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from services.api.admin.passwords import LONGEST, SHORTEST
from services.api.admin.roles import Role
from services.api.replies import Reply
from services.api.settings import Scope

__all__ = [
    "AuditEntry",
    "AuditPage",
    "Credentials",
    "Key",
    "Keys",
    "NewKey",
    "NewPassword",
    "NewUser",
    "OneKey",
    "Session",
    "SignedIn",
    "StaffMember",
    "UserChange",
    "Users",
]

Name = Annotated[str, Meta(min_length=1, max_length=64, pattern=r"^\S(.*\S)?$")]
Password = Annotated[str, Meta(min_length=SHORTEST, max_length=LONGEST)]
Typed = Annotated[str, Meta(max_length=LONGEST)]


class NewKey(msgspec.Struct, frozen=True, kw_only=True):
    """A key to be issued."""

    name: Name
    scopes: Annotated[list[Scope], Meta(min_length=1, max_length=32)]
    expires: float | None = None
    """Seconds since the epoch; null: never."""
    rate: Annotated[float, Meta(gt=0.0, le=100_000.0)] | None = None
    """Requests per second; null: as the setting ``key_rate`` says."""


class Key(Reply, frozen=True, kw_only=True):
    """A key that was issued."""

    id: str
    name: str
    scopes: list[Scope]
    rate: float
    created: float
    expires: float | None
    last_used: float | None
    """To the hour; null: not yet."""


class OneKey(Reply, frozen=True, kw_only=True):
    """A key that was just issued, with the secret: it is told this once."""

    id: str
    name: str
    scopes: list[Scope]
    rate: float
    created: float
    expires: float | None
    last_used: float | None
    key: str


class Keys(Reply, frozen=True, kw_only=True):
    """The keys that were issued, newest first; those of the settings are not among them."""

    t: float
    keys: list[Key]


class NewUser(msgspec.Struct, frozen=True, kw_only=True):
    """Somebody to be let in."""

    name: Name
    role: Role
    password: Password


class UserChange(msgspec.Struct, frozen=True, kw_only=True):
    """Another role, another password, or both."""

    role: Role | None = None
    password: Password | None = None


class StaffMember(Reply, frozen=True, kw_only=True):
    """One of the staff."""

    name: str
    role: Role
    created: float


class Users(Reply, frozen=True, kw_only=True):
    """The staff, by name."""

    t: float
    users: list[StaffMember]


class Credentials(msgspec.Struct, frozen=True, kw_only=True):
    """Who wants in."""

    user: Typed
    password: Typed


class NewPassword(msgspec.Struct, frozen=True, kw_only=True):
    """One's own password, and the one to be."""

    password: Typed
    new_password: Password


class SignedIn(Reply, frozen=True, kw_only=True):
    """A sign-in; ``token`` goes where a key goes until ``expires``."""

    token: str
    user: str
    role: Role
    scopes: list[Scope]
    expires: float


class Session(Reply, frozen=True, kw_only=True):
    """Whose key or token this is, and what it may do."""

    name: str
    role: str | None
    """Null: a key."""
    scopes: list[Scope]
    expires: float | None


class AuditEntry(Reply, frozen=True, kw_only=True):
    """Somebody changed something or looked somebody up."""

    id: int
    t: float
    who: str
    action: str
    """The method of the request."""
    subject: str
    """The path of the request, or of what it made."""
    status: int
    times: int
    """How often within a minute, of look-ups; within an hour, of reads that name whomever there is."""
    detail: str
    """What there was before; of a stream, that it opened or ended."""


class AuditPage(Reply, frozen=True, kw_only=True):
    """Entries, newest first; ``next``, as ``before``, asks for the next page, null: there is none."""

    t: float
    entries: list[AuditEntry]
    next: int | None
