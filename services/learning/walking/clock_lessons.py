"""Cameras' clocks read off steps, in the form of a learner: it proposes nothing, the site file holds the latency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from services.learning.proposal import Proposal
from services.learning.report_draft import ReportDraft
from services.learning.tracks.stretch import Stretch
from services.learning.walking.step_clock import StepClock
from shared.learning_report import ModelKind
from shared.messages import DetectionFrame, Message, MotionBatch

__all__ = ["ClockLessons"]


class ClockLessons:
    """Reads the clocks of one area's cameras; after a restart anew, which takes some minutes of walking.

    Args:
        area: its id.
        cameras: their ids.
    """

    kind: ClassVar[ModelKind] = "alignment"

    def __init__(self, area: str, cameras: Sequence[str]) -> None:
        self._area, self._cameras = area, tuple(cameras)
        self._clock = StepClock()

    def watch(self, message: Message) -> None:
        """Take in what cameras saw and phones stepped."""
        if isinstance(message, DetectionFrame):
            self._clock.take_frame(message)
        elif isinstance(message, MotionBatch):
            self._clock.take_motion(message)

    def learn(self, stretch: Stretch) -> None:
        """Take in a stretch, soon after it was closed."""
        self._clock.learn(stretch)

    def forget(self, device: str) -> None:
        """Forget a device's steps."""
        self._clock.forget(device)

    def propose(self, now: float, until: float) -> Sequence[Proposal]:
        """Return nothing: a latency is for whoever installs the camera to set."""
        return ()

    def activated(self, model: Message) -> None:
        """Nothing here depends on a model."""

    def tell(self, draft: ReportDraft) -> None:
        """Add what is known of each camera's clock."""
        for camera in self._cameras:
            found = self._clock.reading(camera)
            draft.camera(camera, self._area, clock=found.offset, clock_error=found.error)
            draft.camera_words(camera, self._area, found.words)

    def state(self) -> dict[str, Any]:
        """Return nothing: a clock may be another one after a restart."""
        return {}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Begin anew."""
