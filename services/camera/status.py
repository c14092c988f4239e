"""How is this camera doing? Keeps the published CameraStatus true: on change at once, otherwise every few seconds."""

from __future__ import annotations

import time
from collections import deque
from typing import Literal

from shared.bus import Publisher
from shared.messages import CameraStatus

__all__ = ["StatusBoard"]

REFRESH = 5.0
"""Seconds between two publications of an unchanged status."""
RATE_WINDOW = 5.0
"""Seconds over which frames per second are counted."""

State = Literal["starting", "ok", "degraded", "ended"]


class StatusBoard:
    """The state of one camera, published when it changes and refreshed while it does not."""

    def __init__(self, publisher: Publisher[CameraStatus], camera: str) -> None:
        self._publisher = publisher
        self._camera = camera
        self._state: State = "starting"
        self._reason = ""
        self._origin: float | None = None
        self._frames = 0
        self._dropped = 0
        self._recent: deque[float] = deque()
        self._published = -REFRESH
        self._version = 0
        self._geometry = ""

    def change(self, state: State, reason: str = "") -> None:
        """Publish a new state, or a new reason for it, if it is one."""
        if (state, reason) != (self._state, self._reason):
            self._state, self._reason = state, reason
            self._publish()

    def adopted(self, version: int) -> None:
        """Publish which learned settings the detector works with."""
        self._version = version
        self._publish()

    def calibrated(self, geometry: str) -> None:
        """Publish which calibration is in use."""
        self._geometry = geometry
        self._publish()

    def begin_pass(self, origin: float) -> None:
        """Publish the measurement time of the first frame of a pass, before its frames."""
        self._origin = origin
        self._publish()

    def count(self, dropped: int) -> None:
        """Note one frame, and how many were overtaken so far."""
        now = time.monotonic()
        self._frames += 1
        self._dropped = dropped
        self._recent.append(now)
        while now - self._recent[0] > RATE_WINDOW:
            self._recent.popleft()

    def refresh(self) -> None:
        """Publish the status again if it was not published for a while; cheap enough for every frame."""
        if time.monotonic() - self._published >= REFRESH:
            self._publish()

    def _publish(self) -> None:
        self._published = now = time.monotonic()
        while self._recent and now - self._recent[0] > RATE_WINDOW:
            self._recent.popleft()
        span = now - self._recent[0] if len(self._recent) > 1 else 0.0
        self._publisher.publish(
            CameraStatus(
                t=time.time(),
                camera=self._camera,
                state=self._state,
                reason=self._reason,
                frames=self._frames,
                dropped=self._dropped,
                frames_per_s=round((len(self._recent) - 1) / span, 2) if span > 0.0 else 0.0,
                origin=self._origin,
                settings_version=self._version,
                geometry=self._geometry,
            )
        )
