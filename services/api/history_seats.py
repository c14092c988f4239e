"""Questions about the past wait long: so many at once and no more, so that other requests keep their threads."""

from __future__ import annotations

from collections import Counter
from collections.abc import AsyncIterator

from fastapi import Request

from services.api.auth import Holder, too_many
from services.api.problems import Problem, ProblemError

__all__ = ["HistorySeats"]

MOST = 16
"""Of the forty threads that answer requests."""
MOST_OF_ONE = 8
WAIT = 5.0
"""Seconds after which somebody who was refused may come again."""


class HistorySeats:
    """Counts who asks about the past now; belongs to the event loop."""

    def __init__(self) -> None:
        self._taken: Counter[str] = Counter()

    async def taken(self, request: Request) -> AsyncIterator[None]:
        """Hold a seat while a question is answered; a dependency of routes.

        Raises:
            ProblemError: there is none, or none for this key or person.
        """
        holder: Holder = request.state.holder
        if self._taken[holder.account] >= MOST_OF_ONE:
            raise ProblemError(*too_many(f"one key or person may ask {MOST_OF_ONE} such questions at once", WAIT))
        if self._taken.total() >= MOST:
            raise ProblemError(
                Problem(
                    type="urn:atrium:busy",
                    title="Busy",
                    status=503,
                    detail="many ask about the past just now; positions and streams do not depend on it",
                ),
                {"Retry-After": f"{WAIT:.0f}"},
            )
        self._taken[holder.account] += 1
        try:
            yield
        finally:
            self._taken[holder.account] -= 1
            if not self._taken[holder.account]:
                del self._taken[holder.account]
