"""What the learning page asks the API, and what it orders: one answer for all browsers, words where there is none."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import httpx
import msgspec
import structlog

from services.dashboard.sessions import Visitor
from shared.learning_report import LearningReport

__all__ = ["LearningClient", "LearningView", "NoAnswer"]

log = structlog.get_logger(__name__)

KEPT = 2.0
"""Seconds a report serves every browser."""


class LearningView(LearningReport, frozen=True, kw_only=True):
    """The report as the API tells it to this dashboard."""

    may_change: bool = False
    """Whether whoever asks may roll back and freeze."""


class _Done(msgspec.Struct):
    words: str


class NoAnswer(RuntimeError):  # noqa: N818 - told to people, no fault of this program
    """Why there is nothing to show, in plain words."""


class LearningClient:
    """Belongs to one event loop.

    Args:
        api_url: without a slash at the end.
        api_key: the dashboard's own, or the token of one of the staff; never shown.
        visitor: whose token it is; None: all who did not sign in by name.
    """

    def __init__(self, api_url: str, api_key: str, visitor: Visitor | None = None) -> None:
        self._api_url = api_url
        self._url = f"{api_url}/v1/learning"
        self._visitor = visitor
        self._headers = {"Authorization": f"Bearer {api_key}"}
        self._lock = asyncio.Lock()
        self._asked = -KEPT
        self._report: LearningView | NoAnswer = NoAnswer("Nothing has been asked yet.")

    def of(self, visitor: Visitor) -> LearningClient:
        """Return a client that asks for ``visitor``: of their own for one of the staff, else this one."""
        return LearningClient(self._api_url, visitor.key, visitor) if visitor.name else self

    async def report(self) -> LearningView:
        """Return what learning tells now, at most ``KEPT`` seconds old.

        Raises:
            NoAnswer: the API or learning does not answer.
        """
        async with self._lock:
            if time.monotonic() - self._asked >= KEPT:
                try:
                    body = (await self._send("GET", "")).content
                    self._report = msgspec.json.decode(body, type=LearningView)
                except NoAnswer as reason:
                    self._report = reason
                except msgspec.MsgspecError as error:
                    log.warning("the API's answer was not understood", error=str(error))
                    self._report = NoAnswer("The API's answer was not understood; do both have the same version?")
                self._asked = time.monotonic()
            if isinstance(self._report, NoAnswer):
                raise NoAnswer(str(self._report))
            return self._report

    async def picture(self, area: str, kind: str, access_point: str | None) -> str:
        """Return a learned map as SVG.

        Raises:
            NoAnswer: there is none yet, or nobody answers.
        """
        query = {} if access_point is None else {"access_point": access_point}
        return (await self._send("GET", f"/maps/{area}/{kind}.svg", params=query)).text

    async def order(self, what: str, body: dict[str, str] | None = None) -> str:
        """Give an order (rollback, freeze, unfreeze) and return what was done, in words.

        Raises:
            NoAnswer: it was refused, or nobody answers.
        """
        answer = await self._send("POST", f"/{what}", content=msgspec.json.encode(body))
        self._asked = -KEPT
        try:
            return msgspec.json.decode(answer.content, type=_Done).words
        except msgspec.MsgspecError as error:
            raise NoAnswer("The API's answer was not understood; do both have the same version?") from error

    async def _send(self, method: str, path: str, **more: Any) -> httpx.Response:
        try:
            # The address comes from the operator: proxies of the environment are not for it.
            async with httpx.AsyncClient(headers=self._headers, timeout=10.0, trust_env=False) as client:
                answer = await client.request(method, self._url + path, **more)
        except httpx.HTTPError as error:
            log.debug("no answer", error=repr(error))
            raise NoAnswer("The API does not answer; is it running?") from error
        if answer.status_code == 401 and self._visitor is not None:
            self._visitor.ended = True
            raise NoAnswer("Your sign-in has ended.")
        if answer.status_code in (401, 403) and self._visitor is None:
            raise NoAnswer(
                "The API does not let this dashboard's key do that; learning needs the scope learning, "
                "and learning-admin to change anything."
            )
        if answer.status_code != 200:
            raise NoAnswer(_reason(answer))
        return answer


def _reason(answer: httpx.Response) -> str:
    """Return what the API says is the matter, as a sentence."""
    try:
        words = str(answer.json()["detail"])
    except (ValueError, KeyError, TypeError):
        return f"The API has a problem of its own (status {answer.status_code})."
    return words[:1].upper() + words[1:] + ("" if words.endswith((".", "!", "?")) else ".")
