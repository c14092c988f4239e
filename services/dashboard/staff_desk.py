"""Staff sign in at the API, which knows their names, roles and passwords; the dashboard keeps the token they get."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from dataclasses import dataclass

import httpx
import msgspec
import structlog

from services.dashboard.sessions import Sessions, Visitor

__all__ = ["Refused", "StaffDesk"]

log = structlog.get_logger(__name__)

EVERY = 10.0
"""Seconds between two looks whether the sign-ins of staff still hold."""
PATIENCE = 15.0


@dataclass(frozen=True, slots=True)
class Refused:
    """Why somebody is not let in, in plain words."""

    words: str
    status: int
    wait: int = 0
    """Seconds until there is another try."""


class _SignedIn(msgspec.Struct):
    token: str
    user: str
    role: str
    scopes: list[str]
    expires: float


class StaffDesk:
    """Belongs to one event loop.

    Args:
        api_url: without a slash at the end.
        api_key: the dashboard's own: the API believes who shows it for whom they ask.
    """

    def __init__(self, api_url: str, api_key: str) -> None:
        self._url = f"{api_url}/v1/session"
        self._api_key = api_key

    async def sign_in(self, name: str, password: str, source: str) -> Visitor | Refused:
        """Return who signed in, or why they did not; their guesses are counted as those of ``source``."""
        body = msgspec.json.encode({"user": name, "password": password})
        answer = await self._send("POST", self._api_key, body, {"X-Atrium-Client": source})
        if answer is None:
            return Refused("Names cannot be checked now: the API does not answer.", 503)
        if answer.status_code == 429:
            seconds = answer.headers.get("retry-after", "")
            wait = int(seconds) if seconds.isdecimal() else 30
            return Refused(f"Too many attempts. Please wait {wait} seconds.", 429, wait)
        if answer.status_code in (401, 422):
            return Refused("Name or password is wrong.", 401)
        try:
            told = msgspec.json.decode(answer.content, type=_SignedIn)
        except msgspec.MsgspecError:
            log.warning("the API's answer was not understood", status=answer.status_code)
            return Refused(f"Names cannot be checked now: the API has a problem (status {answer.status_code}).", 503)
        return Visitor(told.token, told.user, told.role, frozenset(told.scopes), told.expires)

    async def sign_out(self, visitor: Visitor) -> None:
        """End a sign-in here, and at the API if it answers; else nobody has the token any more."""
        visitor.ended = True
        if visitor.name:
            await self._send("DELETE", visitor.key)

    async def watch(self, sessions: Sessions) -> None:
        """Until cancelled: whose sign-in the API has ended (another role, taken out) is signed out here, too."""
        while True:
            await asyncio.sleep(EVERY)
            await self.look(sessions.staff())

    async def look(self, staff: Iterable[Visitor]) -> None:
        """End what the API has ended."""
        for visitor in staff:
            answer = await self._send("GET", visitor.key)
            if answer is not None and answer.status_code == 401:
                visitor.ended = True

    async def _send(
        self, method: str, key: str, body: bytes | None = None, headers: dict[str, str] | None = None
    ) -> httpx.Response | None:
        shown = {"Authorization": f"Bearer {key}", **(headers or {})}
        try:
            # The address comes from the operator: proxies of the environment are not for it.
            async with httpx.AsyncClient(timeout=PATIENCE, trust_env=False) as client:
                return await client.request(method, self._url, content=body, headers=shown)
        except httpx.HTTPError as error:
            log.debug("no answer", error=repr(error))
            return None
