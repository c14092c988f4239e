"""What a learner proposes, and what a learner is: the contract between lessons and activation.

A learner is a pure state machine over stretches, in order of time: no clock, no bus, no file. It never activates
anything; it proposes, and ``activation`` has the proposal tried on held-out tracks before it goes live.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from services.learning.tracks.stretch import Stretch
from shared.learning_report import ModelKind
from shared.messages import Message

__all__ = ["Learner", "Proposal"]


@dataclass(frozen=True)
class Proposal:
    """A candidate model.

    Attributes:
        kind: of model.
        subject: the area, camera or device it is of.
        area: whose fusion is asked to try it.
        model: what is published if it wins; its ``version`` is 0, whoever activates numbers it.
        question: what fusion's ``rescore`` is asked, JSON; empty where the learner has scored it itself.
        trained_until: seconds since the epoch; nothing newer has taught it, so that what is newer may judge it.
        gain: by how much it is better on held-out data, where the learner has scored it itself; ``margin``: by how
            much it must be.
        margin: see above.
        evidence: numbers a person wants to see: readings, residuals before and after …
        reason: why now, in plain words.
        urgent: something changed, so that the live model is wrong meanwhile: it was taught until ``trained_until`` just
            now and is tried on the first minutes that come, before whatever else waits for a trial.
    """

    kind: ModelKind
    subject: str
    area: str
    model: Message
    trained_until: float
    question: bytes = b""
    gain: float | None = None
    margin: float | None = None
    evidence: Mapping[str, float] = field(default_factory=dict)
    reason: str = ""
    urgent: bool = False


class Learner(Protocol):
    """Learns one kind of model of one area from good stretches."""

    @property
    def kind(self) -> ModelKind:
        """Which kind of model it learns."""
        ...

    def learn(self, stretch: Stretch) -> None:
        """Take in a stretch that may teach; stretches of one device come in order of time."""
        ...

    def forget(self, device: str) -> None:
        """Forget what was learned of a device, and whatever of its data is kept; sums over many people may stay."""
        ...

    def propose(self, now: float, until: float) -> Sequence[Proposal]:
        """Return what deserves a trial at ``now``, taught by nothing newer than ``until`` (seconds since the epoch)."""
        ...

    def activated(self, model: Message) -> None:
        """A model of this kind went live (also one from before a restart, an import or a roll-back)."""
        ...

    def state(self) -> dict[str, Any]:
        """Return all it knows, as what ``msgspec.json`` encodes."""
        ...

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            ValueError: it is no such state; the learner is then unchanged.
        """
        ...
