"""Which technical trouble is worth telling somebody who is not looking? What lasts: once, and once when it is over.

Pure: time comes in as an argument.
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from services.api.replies import Reply

__all__ = ["Finding", "Trouble", "TroubleWatch"]

FLICKER = 5.0
"""Seconds for which trouble may be gone and be the same."""
MOST = 1000
"""Findings that are followed at once: their names come from outside."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong now; ``words`` may change while ``service``, ``instance`` and ``topic`` stay."""

    service: str
    instance: str
    topic: str
    words: str

    @property
    def key(self) -> tuple[str, str, str]:
        """What stays the same for as long as it lasts."""
        return self.service, self.instance, self.topic


class Trouble(Reply, frozen=True, kw_only=True):
    """Something technical is wrong for a while (``trouble``), or no longer is (``recovered``)."""

    id: str
    t: float
    """When it was told."""
    kind: Literal["trouble", "recovered"]
    service: str
    """Which program it is about or who says it; ``bus``: the router."""
    topic: str
    """What it is about, such as ``camera hall-east``."""
    words: str
    """In plain words, as `/v1/health` says it; of ``recovered``, what it was."""
    since: float
    """When it began; of ``recovered`` too."""


@dataclass(slots=True)
class _Followed:
    finding: Finding
    since: float
    last: float
    told: bool = False
    id: str = field(default_factory=lambda: secrets.token_hex(8))


class TroubleWatch:
    """Follows what is wrong.

    Args:
        after: seconds it must last to be told, and be gone to be over.
    """

    def __init__(self, after: float) -> None:
        self._after = after
        self._followed: dict[tuple[str, str, str], _Followed] = {}

    def take(self, now: float, findings: Sequence[Finding], *, connected: bool) -> list[Trouble]:
        """Take in what is wrong at ``now`` (s since the epoch); return what is to be told.

        While the bus is not ``connected`` what others found counts on: nobody hears whether it is over.
        """
        for finding in findings:
            known = self._followed.get(finding.key)
            if known is not None:
                known.finding, known.last = finding, now
            elif len(self._followed) < MOST:
                self._followed[finding.key] = _Followed(finding, now, now)
        present = {finding.key for finding in findings}
        told = []
        for key, one in list(self._followed.items()):
            if key in present:
                if not one.told and now - one.since >= self._after:
                    one.told = True
                    told.append(_trouble(one, "trouble", now))
            elif not connected:
                one.last = now
            elif now - one.last >= (self._after if one.told else FLICKER):
                del self._followed[key]
                if one.told:
                    told.append(_trouble(one, "recovered", now))
        return told


def _trouble(one: _Followed, kind: Literal["trouble", "recovered"], now: float) -> Trouble:
    service, instance, topic = one.finding.key
    about = topic or instance
    words = one.finding.words
    return Trouble(id=f"{one.id}-{kind}", t=now, kind=kind, service=service, topic=about, words=words, since=one.since)
