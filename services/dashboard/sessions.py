"""Who has signed in: sessions are kept here, browsers hold a random number, and what is ended is over at once.

They are in memory only, with the tokens of staff: after a restart of the dashboard people sign in again.
"""

from __future__ import annotations

import hashlib
import hmac
import math
import secrets
import time
from collections import OrderedDict
from dataclasses import dataclass

from starlette.requests import HTTPConnection

__all__ = ["Sessions", "Visitor", "asked_by"]

MOST = 2000
"""Sessions; the oldest gives way."""


@dataclass(eq=False, slots=True)
class Visitor:
    """Whom a browser belongs to."""

    key: str
    """With which the API is asked for them: the token of a sign-in, or the dashboard's own key. No browser sees it."""
    name: str = ""
    """Of one of the staff; empty: whoever knows the shared password."""
    role: str = ""
    scopes: frozenset[str] | None = None
    """What the API lets one of the staff do; None: what the dashboard's key may."""
    expires: float = math.inf
    """Wall clock."""
    ended: bool = False

    @property
    def here(self) -> bool:
        """Whether the session still holds."""
        return not self.ended and time.time() < self.expires

    def may(self, scope: str | None) -> bool:
        """Whether what asks for ``scope`` may be told them; None: it tells of nobody."""
        return scope is None or self.scopes is None or scope in self.scopes


def asked_by(connection: HTTPConnection, api_key: str) -> Visitor:
    """Return whose request it is: the door has noted it; whoever has the dashboard's key where there is no door."""
    noted: Visitor | None = connection.scope.get("state", {}).get("visitor")
    return Visitor(api_key) if noted is None else noted


class Sessions:
    """Checks the shared password and keeps who has signed in.

    Args:
        password: the shared one; empty: there is none.
        api_key: the dashboard's own.
        hours: after which a session ends.
        staff_only: without a shared password only staff come in; else everybody does.
    """

    def __init__(self, password: str, api_key: str, hours: float, *, staff_only: bool = False) -> None:
        self._password = password.encode()
        self._api_key = api_key
        self.seconds = int(hours * 3600)
        self.shared = bool(password)
        """Whether there is a shared password."""
        self.open = not password and not staff_only
        """Whether everybody may look."""
        self.anybody = Visitor(api_key)
        """Everybody, where it is open."""
        self._visitors: OrderedDict[bytes, Visitor] = OrderedDict()

    def right(self, password: str) -> bool:
        """Whether this is the shared password; takes the same time either way."""
        return self.shared and hmac.compare_digest(password.encode(), self._password)

    def begin(self, visitor: Visitor | None = None) -> str:
        """Keep a session, by default of whoever knows the shared password; return what their browser shows for it."""
        visitor = Visitor(self._api_key) if visitor is None else visitor
        visitor.expires = min(visitor.expires, time.time() + self.seconds)
        shown = secrets.token_urlsafe(32)
        self._visitors = OrderedDict((digest, one) for digest, one in self._visitors.items() if one.here)
        if len(self._visitors) >= MOST:
            self._visitors.popitem(last=False)[1].ended = True
        self._visitors[_digest(shown)] = visitor
        return shown

    def find(self, shown: str) -> Visitor | None:
        """Return whose session a browser shows, None if it is none, or one that has ended."""
        visitor = self._visitors.get(_digest(shown))
        return visitor if visitor is not None and visitor.here else None

    def staff(self) -> list[Visitor]:
        """Return those who signed in by name."""
        return [visitor for visitor in self._visitors.values() if visitor.name and visitor.here]


def _digest(shown: str) -> bytes:
    return hashlib.sha256(shown.encode("utf-8", "replace")).digest()
