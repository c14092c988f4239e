"""A learner in its place: under which name it is kept, and whose stretches it is given."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from services.learning.proposal import Learner, Proposal
from services.learning.tracks.stretch import Stretch
from shared.learning_command import LearningAnswer, LearningCommand
from shared.messages import Message

__all__ = ["Alert", "Critic", "Lesson", "MapKeeping", "Personal", "Watching", "Weighing"]


@dataclass(frozen=True)
class Lesson:
    """A learner and where it learns.

    Attributes:
        name: under which its state is kept; no other lesson has it.
        learner: a pure state machine.
        areas: ids of the areas whose good stretches teach it; a phone's stride is learned in all of them.
        anew: makes the learner as it was before it learned anything.
    """

    name: str
    learner: Learner
    areas: frozenset[str]
    anew: Callable[[], Learner]


@runtime_checkable
class Watching(Protocol):
    """A learner or judge that wants messages beside stretches: frames, detections. None has to."""

    def watch(self, message: Message) -> None:
        """Take in a message of its areas, in the order in which it came; must be quick."""
        ...


@runtime_checkable
class Weighing(Protocol):
    """A learner that can do with names that are often wrong, and wants to be told more for it. None has to."""

    def learn_doubtful(self, stretch: Stretch) -> None:
        """Take in a stretch that is too short or too much like others' to be sure of, in order like the sure ones."""
        ...


@runtime_checkable
class Alert(Protocol):
    """A learner that notices when its model becomes wrong all at once. None has to."""

    def alarms(self, now: float) -> Sequence[Proposal]:
        """Return urgent candidates, taught by all there is at ``now``; is asked at every look, so it must be quick."""
        ...


@runtime_checkable
class Critic(Protocol):
    """A learner that can tell whether a model that went live should have: of kinds that fusion cannot try."""

    def regret(self, former: Message, since: float) -> tuple[float, float] | None:
        """Return by how much the model before was better on what came after ``since``, and by how much it must be.

        None: too little has come, or nothing can be told.
        """
        ...


@runtime_checkable
class Personal(Protocol):
    """A learner whose phones are let go once they stay away; none has to."""

    @property
    def devices(self) -> Collection[str]:
        """Of whom something is known."""
        ...


@runtime_checkable
class MapKeeping(Protocol):
    """A learner that keeps maps of an area; none has to."""

    def map(self, command: LearningCommand) -> LearningAnswer | None:
        """Answer an order for a map of this learner's; None where it is for another one."""
        ...
