"""Who may read and do what: keys with scopes and sign-ins of staff, deny by default; and how often.

A plain ASGI layer rather than a dependency per route, so that a hot read pays microseconds for it and no route can be
forgotten: a path nobody listed needs a key too.
"""

from __future__ import annotations

import hashlib
import hmac
import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from starlette.types import ASGIApp, Receive, Send
from starlette.types import Scope as Connection

from services.api.problems import Problem, ProblemError, problem_response
from services.api.settings import ApiKey, Scope
from shared.rate_limiter import RateLimiter

__all__ = ["OPEN_PATHS", "SCOPES", "Guard", "Holder", "KeyRing", "needs", "presented_key", "too_many"]

OPEN_PATHS = frozenset({"/", "/docs", "/openapi.json"})
OPEN_FOLDER = "/static-offline-docs/"
"""Script and style of the page at ``/docs``; served from here, because many sites have no internet."""
"""Documentation tells nothing about anybody."""

SIGN_IN = "/v1/session"
"""Staff post their names and passwords there to get in."""

SCOPES: dict[str, Scope] = {
    "positions": "positions",
    "tracks": "positions",
    "alerts": "alerts",
    "zones": "site",
    "exhibits": "site",
    "site": "site",
    "cameras": "site",
    "access-points": "site",
    "health": "health",
    "learning": "learning",
    "trajectories": "positions",
    "erasures": "positions",
    "privacy": "site",
    "occupancy": "site",
    "heatmap": "site",
    "dwell": "site",
    "flows": "site",
    "webhooks": "webhooks",
    "devices": "positions",
    "keys": "accounts",
    "users": "accounts",
    "audit": "audit",
}
"""The scope that the first part of a path below ``/v1/`` asks for. Streams are not listed: each of their events
asks for one of its own."""
CHANGES: dict[str, Scope] = {
    "zones": "zones-admin",
    "exhibits": "zones-admin",
    "learning": "learning-admin",
    "alerts": "acknowledge",
    "devices": "erase",
}
"""What anything but a read asks for there."""
ADMIN_READS = frozenset({"/v1/learning/export"})
"""Reads that take all models out of the house."""


@dataclass(frozen=True)
class Holder:
    """Whose key it is: its ``name`` for logs, and what it may read and do."""

    name: str
    scopes: frozenset[Scope]
    expires: float = math.inf
    """Wall clock."""
    rate: float | None = None
    """Requests per second; None: any."""
    id: str = ""
    """Of a key that was issued, or of a sign-in; empty: of the settings."""
    role: str | None = None
    """Of a sign-in."""

    @property
    def account(self) -> str:
        """What bounds count as one: a key, or a person however often they signed in."""
        return f"key {self.id or self.name}" if self.role is None else f"user {self.name}"


class KeyRing:
    """The keys that open something. Only digests are kept.

    Args:
        keys: of the settings.
        issued: returns the holders of what was issued since, by digest; asked at each request.
    """

    def __init__(self, keys: Iterable[ApiKey], issued: Callable[[], Mapping[bytes, Holder]] = dict) -> None:
        self._keys = [
            (_digest(key.key.get_secret_value().encode()), Holder(key.name, frozenset(key.scopes))) for key in keys
        ]
        self._issued = issued

    def holder_of(self, presented: bytes) -> Holder | None:
        """Return who holds ``presented``, None if it is no key; the time taken does not depend on which it is."""
        digest = _digest(presented)
        found = None
        for known, holder in self._keys:
            if hmac.compare_digest(known, digest):
                found = holder
        # Of a digest nobody can choose the beginning: how long the search takes tells nothing.
        return found or self._issued().get(digest)

    def refusal(self, presented: bytes | None) -> Problem | None:
        """Return why ``presented`` opens nothing, or nothing any more; None: it opens something."""
        holder = None if presented is None else self.holder_of(presented)
        return _no_key(presented, holder) if holder is None or holder.expires <= time.time() else None


class Guard:
    """ASGI layer that lets a request through only with a key that has the path's scope."""

    def __init__(self, app: ASGIApp, ring: KeyRing, note_use: Callable[[Holder], None] = lambda _: None) -> None:
        self._app = app
        self._note_use = note_use
        self._ring = ring
        # A second's worth of requests at once; each costs its share of a second.
        self._rations = RateLimiter(per_second=1.0, burst=1)

    async def __call__(self, connection: Connection, receive: Receive, send: Send) -> None:
        """Answer 401, 403 or 429, or hand the request on."""
        if connection["type"] == "lifespan" or _is_open(connection):
            await self._app(connection, receive, send)
            return
        presented = presented_key(connection)
        holder = None if presented is None else self._ring.holder_of(presented)
        problem = _refusal(connection, presented, holder)
        headers = {"WWW-Authenticate": 'Bearer realm="atrium"'} if problem and problem.status == 401 else None
        if problem is None and holder is not None and holder.rate is not None:
            cost = min(1.0, 1.0 / holder.rate)
            wait = self._rations.wait(holder.account, cost)
            if wait > 0.0:
                problem, headers = too_many(f"this key may ask {holder.rate:g} times per second", wait)
            else:
                self._rations.spend(holder.account, 1.0 / holder.rate)
        connection.setdefault("state", {})["holder"] = holder
        if problem is not None:
            await problem_response(problem, headers)(connection, receive, send)
            return
        if holder is not None:
            self._note_use(holder)
        await self._app(connection, receive, send)


def needs(holder: Holder, scope: Scope) -> None:
    """Let only keys go on that have one more scope: of a path that needs several, or of a part of what it tells.

    Raises:
        ProblemError: this one has not.
    """
    if scope not in holder.scopes:
        raise ProblemError(
            Problem(
                type="urn:atrium:forbidden",
                title="Scope missing",
                status=403,
                detail=f"this key may not {_MAY_NOT.get(scope, 'read ' + scope)}",
                field="Authorization",
                found=f"a key with the scopes {', '.join(sorted(holder.scopes))}",
                allowed=f"a key with the scope {scope}, too",
            )
        )


def too_many(detail: str, wait: float) -> tuple[Problem, dict[str, str]]:
    """Return the 429 for who asks too often, and when to come again."""
    seconds = max(1, math.ceil(wait))
    problem = Problem(
        type="urn:atrium:too-many-requests",
        title="Too many requests",
        status=429,
        detail=f"{detail}; try again in {seconds} s",
    )
    return problem, {"Retry-After": str(seconds)}


def _is_open(connection: Connection) -> bool:
    path = connection["path"]
    return (
        path in OPEN_PATHS
        or path.startswith(OPEN_FOLDER)
        or (path == SIGN_IN and connection["type"] == "http" and connection["method"] == "POST")
    )


def _refusal(connection: Connection, presented: bytes | None, holder: Holder | None) -> Problem | None:
    if holder is None or holder.expires <= time.time():
        return _no_key(presented, holder)
    needed = _needed_scope(connection["path"], connection.get("method", "GET"))
    if needed is not None and needed not in holder.scopes:
        return Problem(
            type="urn:atrium:forbidden",
            title="Scope missing",
            status=403,
            detail=f"this key may not {_MAY_NOT.get(needed, 'read ' + needed)}",
            field="Authorization",
            found=f"a key with the scopes {', '.join(sorted(holder.scopes)) or 'none'}",
            allowed=f"a key with the scope {needed}",
        )
    return None


_MAY_NOT: dict[Scope, str] = {
    "positions": "read positions, which tell of single phones",
    "learning-admin": "change learning",
    "zones-admin": "change zones and exhibits",
    "accounts": "see or change who may come in",
    "audit": "read the audit log",
    "acknowledge": "acknowledge alerts",
    "webhooks": "see or change webhooks",
    "setup": "change how the site is set up",
    "stills": "see pictures of cameras",
    "erase": "end the consent of phones",
}


def _no_key(presented: bytes | None, holder: Holder | None) -> Problem:
    return Problem(
        type="urn:atrium:unauthorized",
        title="No valid key",
        status=401,
        detail="this path needs an API key: send 'Authorization: Bearer KEY' or 'X-API-Key: KEY'",
        field="Authorization",
        found="no key"
        if presented is None
        else "a key that is not known"
        if holder is None
        else "a key that has expired",
        allowed="a key of the settings, one that was issued and holds, or the token of a sign-in",
    )


def _needed_scope(path: str, method: str) -> Scope | None:
    parts = path.split("/", 3)
    if len(parts) <= 2 or parts[1] != "v1":
        return None
    scope = SCOPES.get(parts[2])
    if method not in ("GET", "HEAD", "OPTIONS") or path in ADMIN_READS:
        return CHANGES.get(parts[2], scope)
    return scope


def presented_key(connection: Connection) -> bytes | None:
    """Return the key or token that a request carries, None where it carries none."""
    for name, value in connection["headers"]:
        if name == b"authorization" and value[:7].lower() == b"bearer ":
            bearer: bytes = value[7:].strip()
            return bearer
        if name == b"x-api-key":
            key: bytes = value.strip()
            return key
    return None


def _digest(key: bytes) -> bytes:
    return hashlib.sha256(key).digest()
