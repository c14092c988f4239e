"""What one learner's error does to the others: nothing. It is told, and what raised rests for a while.

What raises once mostly raises again on the next message of its kind, thirty times a second: so that very call rests,
and the log stays short. The learner's other calls go on: who cannot propose goes on learning.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import structlog

__all__ = ["REST", "Faults"]

log = structlog.get_logger(__name__)
T = TypeVar("T")

REST = 300.0
"""Seconds for which a call that raised is left out; it is told of for as long again."""


@dataclass
class _Fault:
    """``until``: when its rest ends; infinite until the next look, for here is no clock."""

    error: str
    until: float = math.inf


class Faults:
    """Calls parts, and remembers which of their calls raised.

    A part is named as it is kept, what it is asked for in plain words that go on from "could not".
    """

    def __init__(self) -> None:
        self._faults: dict[tuple[str, str], _Fault] = {}
        self._now = -math.inf

    def call(self, part: str, what: str, work: Callable[..., T], *arguments: object) -> T | None:
        """Return what ``work`` returns; None where it raised, or rests because it did."""
        if self._faults and self.rests(part, what):
            return None
        try:
            return work(*arguments)
        except Exception as error:
            self._note(part, what, error)
            return None

    def done(self, part: str, what: str, work: Callable[..., object], *arguments: object) -> bool:
        """Do what must never be left out, whatever it raised before; whether it did not raise."""
        try:
            work(*arguments)
        except Exception as error:
            self._note(part, what, error)
            return False
        return True

    def rests(self, part: str, what: str) -> bool:
        """Whether this call of a part raised a short while ago."""
        fault = self._faults.get((part, what))
        return fault is not None and self._now < fault.until

    def look(self, now: float) -> None:
        """Go on to ``now``, seconds since the epoch; the clock may have been set back."""
        self._now = now
        for key, fault in list(self._faults.items()):
            fault.until = min(fault.until, now + REST)
            if now >= fault.until + REST:
                del self._faults[key]

    def words(self) -> dict[str, str]:
        """Return by part what it could not do; the same words until something else happens.

        Of an error its name alone: its text may name a phone.
        """
        told: dict[str, list[str]] = {}
        for (part, what), fault in sorted(self._faults.items()):
            told.setdefault(part, []).append(f"could not {what} ({fault.error})")
        return {part: ", ".join(words) for part, words in told.items()}

    def _note(self, part: str, what: str, error: Exception) -> None:
        self._faults[part, what] = _Fault(type(error).__name__)
        log.error("a lesson failed, the others go on", lesson=part, could_not=what, exc_info=error)
