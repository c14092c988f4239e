"""Where is this phone, as far as the tracks say? Only ever asked by the phone itself."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

from services.gateway.protocol import Position
from shared.bus import Inbox
from shared.messages import TrackFrame

__all__ = ["OwnPositions"]


@dataclass(frozen=True, slots=True)
class _Seen:
    frame: TrackFrame
    index: int
    arrived: float


class OwnPositions:
    """The newest track of every device.

    Args:
        kept: seconds a position is told after its last update.
    """

    def __init__(self, kept: float) -> None:
        self._kept = kept
        self._seen: dict[str, _Seen] = {}

    def follow(self, inbox: Inbox, stopping: threading.Event) -> None:
        """Take track frames until ``stopping`` is set; runs in a thread of its own."""
        while not stopping.is_set():
            for delivery in inbox.receive(0.5):
                if isinstance(delivery.message, TrackFrame):
                    self.take(delivery.message, time.monotonic())
            self.forget_old(time.monotonic())

    def take(self, frame: TrackFrame, arrived: float) -> None:
        """Remember where one frame saw which device."""
        for index, device in enumerate(frame.device):
            if device is not None:
                self._seen[device] = _Seen(frame, index, arrived)

    def forget(self, device: str) -> None:
        """Forget one device."""
        self._seen.pop(device, None)

    def forget_old(self, now: float) -> None:
        """Forget positions that are no longer told."""
        for device in [device for device, seen in self._seen.copy().items() if now - seen.arrived > self._kept]:
            self._seen.pop(device, None)

    def of(self, device: str, now: float) -> Position | None:
        """Return the position of one device, None where no track carries it.

        Args:
            device: whose.
            now: the server's clock.
        """
        seen = self._seen.get(device)
        if seen is None:
            return None
        frame, index = seen.frame, seen.index
        return Position(
            t=frame.t,
            age=max(0.0, now - frame.t),
            area=frame.area,
            floor=frame.floor[index],
            x=frame.x[index],
            y=frame.y[index],
            covariance=frame.covariance[index],
            probability=frame.probability[index],
        )
