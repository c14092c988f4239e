"""Asking the history service over the bus; sums that many look at are asked for once in a while."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TypeVar

import msgspec
import structlog

from services.api.problems import Problem, ProblemError
from shared.history_query import (
    AskTrajectory,
    Dwell,
    Flows,
    HeatMap,
    HistoryQuestion,
    OccupancySeries,
    Refusal,
    Trajectory,
    decode_answer,
)
from shared.keys import Keys

__all__ = ["HistoryLink"]

log = structlog.get_logger(__name__)

KEPT = 5.0
"""Seconds a sum is told to everybody who asks the same; trajectories are never kept."""
MOST_KEPT = 32
PATIENCE = 120.0
"""Seconds history has to answer: a day of a full museum takes a second or two, a month as often as it has days."""
WAIT_FOR_OTHERS = 15.0
"""Seconds until a question that found ``AT_ONCE`` others is told to come again."""
AT_ONCE = 4
"""Questions that wait for an answer together; whoever comes then is told to come again."""
_UNKNOWN = ("zone", "area", "floor")

Ask = Callable[[str, float, bytes | None], bytes | None]
"""Key, seconds to wait and payload of a query; returns the first answer, None if there was none."""
A = TypeVar("A", Trajectory, OccupancySeries, HeatMap, Dwell, Flows)


class HistoryLink:
    """May be used from any thread; a question waits for its answer.

    Args:
        keys: of the site.
        ask: sends a query over the bus.
    """

    def __init__(self, keys: Keys, ask: Ask) -> None:
        self._key = keys.history()
        self._ask = ask
        self._lock = threading.Lock()
        self._kept: dict[bytes, tuple[float, bytes]] = {}
        self._places = threading.BoundedSemaphore(AT_ONCE)

    def answer(self, question: HistoryQuestion, kind: type[A]) -> A:
        """Return the answer to a question, a ``kind``.

        Raises:
            ProblemError: history does not answer, or refuses, or something else answers.
        """
        payload = msgspec.json.encode(question)
        told = self._answer(payload, keep=not isinstance(question, AskTrajectory))
        try:
            answer = decode_answer(told)
        except msgspec.MsgspecError as error:
            log.warning("history's answer was not understood", error=str(error))
            raise _away("history's answer was not understood: do both services have the same version?") from error
        if isinstance(answer, Refusal):
            raise _refused(answer)
        if not isinstance(answer, kind):
            raise _away("history answered something else than was asked: do both services have the same version?")
        return answer

    def _answer(self, payload: bytes, keep: bool) -> bytes:
        with self._lock:
            kept = self._kept.get(payload)
        if kept is not None and time.monotonic() - kept[0] < KEPT:
            return kept[1]
        if not self._places.acquire(timeout=WAIT_FOR_OTHERS):
            raise _away("many ask about the past just now")
        try:
            told = self._ask(self._key, PATIENCE, payload)
        finally:
            self._places.release()
        if told is None:
            raise _away("the history service is not running or does not answer; positions do not depend on it")
        if keep:
            with self._lock:
                self._kept.pop(payload, None)
                while len(self._kept) >= MOST_KEPT:
                    del self._kept[next(iter(self._kept))]
                self._kept[payload] = (time.monotonic(), told)
        return told


def _refused(refusal: Refusal) -> ProblemError:
    if not refusal.field:
        return _away(refusal.words)
    missing = refusal.field in _UNKNOWN
    return ProblemError(
        Problem(
            type=f"urn:atrium:unknown-{refusal.field.replace('_', '-')}" if missing else "urn:atrium:invalid-value",
            title=f"Unknown {refusal.field}" if missing else "Invalid value",
            status=404 if missing else 422,
            detail=refusal.words,
            field=refusal.field,
            found=refusal.found[:100],
            allowed=refusal.allowed[:1000],
        )
    )


def _away(words: str) -> ProblemError:
    return ProblemError(
        Problem(type="urn:atrium:no-history", title="History does not answer", status=503, detail=words),
        {"Retry-After": "5"},
    )
