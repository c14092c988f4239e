"""A camera of which only the detections are made: on the bus it looks like any other.

It publishes every frame, tells how it is doing and that it lives, as a camera service would. While a fault keeps it
off it publishes neither frames nor status, but its token of life stays: the process lives, as a camera service does
whose camera hangs. Its frame numbers go on meanwhile, so that who counts them sees how many are missing.
"""

from __future__ import annotations

import time
from collections import deque

from shared.bus import Bus
from shared.keys import Keys
from shared.messages import CameraStatus, DetectionFrame

__all__ = ["TwinCamera"]

REFRESH = 5.0
"""Seconds between two publications of its status, and over which frames per second are counted."""


class TwinCamera:
    """The publishers of one camera.

    Args:
        bus: where it publishes.
        keys: of its site.
        camera: its id.
    """

    def __init__(self, bus: Bus, keys: Keys, camera: str) -> None:
        self._camera = camera
        self._status = bus.publisher(keys.camera_status(camera), CameraStatus, cached=True)
        # All cameras of the twin share one connection, and their frames come at the same instant: the last would often
        # be dropped for want of room, where a camera with a connection of its own loses none.
        self._detections = bus.publisher(keys.detections(camera), DetectionFrame)
        self._frames = 0
        self._recent: deque[float] = deque()
        self._told = -REFRESH
        bus.announce(keys.alive("camera", camera))

    def publish(self, frame: DetectionFrame, origin: float) -> None:
        """Publish a frame, whose time is the bus's, of a world whose second zero was at ``origin``."""
        now = time.monotonic()
        self._frames += 1
        self._recent.append(now)
        while now - self._recent[0] > REFRESH:
            self._recent.popleft()
        if self._frames == 2 or now - self._told >= REFRESH:
            self._told = now
            self._tell(now, origin)
        self._detections.publish(frame)

    def _tell(self, now: float, origin: float) -> None:
        span = now - self._recent[0]
        self._status.publish(
            CameraStatus(
                t=time.time(),
                camera=self._camera,
                state="ok",
                frames=self._frames,
                frames_per_s=round((len(self._recent) - 1) / span, 2) if span > 0.0 else 0.0,
                origin=origin,
            )
        )
