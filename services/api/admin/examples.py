"""One example for each body of what the API keeps itself."""

from __future__ import annotations

from typing import Any

import msgspec

from services.api.admin.account_replies import (
    AuditPage,
    Credentials,
    Key,
    Keys,
    NewKey,
    NewPassword,
    NewUser,
    OneKey,
    Session,
    SignedIn,
    StaffMember,
    UserChange,
    Users,
)
from services.api.admin.exhibits import ExhibitDefinition
from services.api.admin.replies import Exhibit, Exhibits, ExhibitsInFront
from shared.zones import ZoneDefinition

__all__ = ["ADMIN_EXAMPLES", "RULE"]

RULE: dict[str, Any] = {
    "id": "too-long",
    "kind": "dwell",
    "limit": None,
    "direction": "both",
    "target": "",
    "audience": "everybody",
    "devices": [],
    "schedule": None,
    "confidence": 0.5,
    "quiet": 0.0,
}
_SCHEDULE = {"days": [0, 1, 2, 3, 4, 5, 6], "since": "18:00", "until": "08:00"}
_EXHIBIT: dict[str, Any] = {
    "id": "vase",
    "name": "A vase",
    "floor": "ground",
    "x": 5.0,
    "y": 4.0,
    "reach": 8.0,
    "facing": None,
}

_KEY: dict[str, Any] = {
    "id": "k-1a2b3c4d",
    "name": "guide-app",
    "scopes": ["positions"],
    "rate": 50.0,
    "created": 1767225600.28,
    "last_used": 1767225600.0,
    "expires": 1798761600.0,
}
_USER: dict[str, Any] = {"name": "maria", "role": "curator", "created": 1767225600.28}

ADMIN_EXAMPLES: dict[type[msgspec.Struct], dict[str, Any]] = {
    ZoneDefinition: {
        "id": "vault",
        "name": "Vault",
        "floor": "ground",
        "shape": "area",
        "points": [[7.0, 4.0], [13.0, 4.0], [13.0, 6.5], [7.0, 6.5]],
        "rules": [
            {**RULE, "id": "too-long", "kind": "dwell", "limit": 30.0, "audience": "anonymous", "schedule": _SCHEDULE}
        ],
    },
    ExhibitDefinition: _EXHIBIT,
    Exhibit: {**_EXHIBIT, "etag": '"a1b2c3d4e5f60718a1"'},
    ExhibitsInFront: {
        "t": 1767225600.28,
        "device": "d-7f3a",
        "floor": "ground",
        "x": 5.2,
        "y": 1.9,
        "age": 0.08,
        "state": "confirmed",
        "heading": 92.5,
        "heading_age": 4.2,
        "exhibits": [{"id": "vase", "name": "A vase", "distance": 2.11, "bearing": 3.0, "probability": 0.63}],
    },
    NewKey: {"name": "guide-app", "scopes": ["positions"], "expires": 4102444800.0, "rate": None},
    Key: _KEY,
    OneKey: {**_KEY, "last_used": None, "key": "atrium-…"},
    Keys: {"t": 1767225600.28, "keys": [_KEY]},
    NewUser: {"name": "maria", "role": "curator", "password": "correct horse battery"},
    UserChange: {"role": "guard", "password": None},
    StaffMember: _USER,
    Users: {"t": 1767225600.28, "users": [_USER]},
    Credentials: {"user": "maria", "password": "correct horse battery"},
    NewPassword: {"password": "correct horse battery", "new_password": "staple it twice"},
    SignedIn: {
        "token": "atrium-session-…",
        "user": "maria",
        "role": "curator",
        "scopes": ["positions", "site", "zones-admin"],
        "expires": 1767268800.28,
    },
    Session: {
        "name": "maria",
        "role": "curator",
        "scopes": ["positions", "site", "zones-admin"],
        "expires": 1767268800.28,
    },
    AuditPage: {
        "t": 1767225600.28,
        "entries": [
            {
                "id": 42,
                "t": 1767225599.1,
                "who": "guide-app (k-1a2b3c4d)",
                "action": "GET",
                "subject": "/v1/positions/d-7f3a",
                "status": 200,
                "times": 57,
                "detail": "",
            }
        ],
        "next": None,
    },
    Exhibits: {"t": 1767225600.28, "exhibits": [{**_EXHIBIT, "etag": '"a1b2c3d4e5f60718a1"'}]},
}
