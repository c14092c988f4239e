"""What each of the staff may do, by role."""

from __future__ import annotations

from typing import Literal, get_args

from services.api.settings import ALL_SCOPES, READ_SCOPES, Scope

__all__ = ["ROLES", "SCOPES_OF", "Role"]

Role = Literal["viewer", "guard", "desk", "curator", "admin"]
ROLES: tuple[Role, ...] = get_args(Role)

SCOPES_OF: dict[Role, frozenset[Scope]] = {
    "viewer": frozenset(READ_SCOPES),
    "guard": frozenset((*READ_SCOPES, "acknowledge")),
    "desk": frozenset((*READ_SCOPES, "erase")),
    "curator": frozenset((*READ_SCOPES, "zones-admin")),
    "admin": frozenset(ALL_SCOPES),
}
"""A viewer sees everything; a guard acknowledges alerts; the desk ends the consent of visitors who ask; a curator draws
zones and exhibits; an admin may do all."""
