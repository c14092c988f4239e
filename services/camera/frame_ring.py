"""The last minutes of one camera's pictures, small, in memory only: what other detector options are tried on.

Pictures of people never leave the process and never touch a disk: the ring is bounded in bytes, in minutes and in
pictures per second, and is gone with the process. It is as wide as the detector's mask and packed as JPEG.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np

from services.camera.detector import Image

__all__ = ["FrameRing", "KeptFrame", "shrunk", "unpack"]

WIDTH = 480
"""Pixels across: that of the mask the shipped detector finds people on."""
QUALITY = 90
"""Of the JPEG: what it adds is less than the noise the detector expects of any camera."""
GAP = 5.0
"""Seconds without a picture after which those before are dropped: a background cannot be followed across it."""
TOUCHED = 120.0
"""Seconds for which the ring stands still after a question, so that the next one is asked of the same pictures,"""
LONGEST_STILL = 900.0
"""and for how long at most."""


@dataclass(frozen=True, slots=True)
class KeptFrame:
    """One small picture: when it was taken, seconds since the epoch, and its JPEG."""

    t: float
    jpeg: bytes


def unpack(frame: KeptFrame) -> Image:
    """Return the picture (height, width, 3), blue-green-red."""
    return cast(Image, cv2.imdecode(np.frombuffer(frame.jpeg, np.uint8), cv2.IMREAD_COLOR))


class FrameRing:
    """Keeps pictures while it has room, the oldest give way; any thread may ask it.

    Args:
        megabytes: of packed pictures at most; 0 keeps nothing.
        minutes: how far back it reaches.
        rate: pictures per second that are kept.
    """

    def __init__(self, megabytes: float, minutes: float, rate: float) -> None:
        self._limit = int(megabytes * 1e6)
        self._span = 60.0 * minutes
        self._interval = 1.0 / rate
        self._frames: deque[KeptFrame] = deque()
        self._bytes = 0
        self._due = 0.0
        self._size = (0, 0)
        self._now = 0.0
        self._held: float | None = None
        self._until = 0.0
        self._lock = threading.Lock()

    @property
    def keeps(self) -> bool:
        """Whether it may hold anything."""
        return self._limit > 0

    @property
    def held_bytes(self) -> int:
        """Of packed pictures."""
        return self._bytes

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the pictures as the camera delivered them."""
        return self._size

    def offer(self, image: Image, t: float) -> bool:
        """Keep ``image``, taken at ``t``, if one is due; return whether it was kept."""
        if self._limit == 0:
            return False
        size = (image.shape[1], image.shape[0])
        with self._lock:
            self._now = t
            last = self._frames[-1].t if self._frames else None
            if self._held is not None:
                if self._held <= t < self._until:
                    return False
                self._held = None
            if size != self._size or (last is not None and not last <= t < last + max(GAP, 2.0 * self._interval)):
                self._drop_all()
                self._size, self._due = size, t
            if t < self._due - 1e-3:
                return False
        packed = KeptFrame(t, _pack(image))
        with self._lock:
            # Pictures that come at 25 a second are kept at even 4 a second, not at 3.6.
            self._due = max(self._due + self._interval, t)
            self._frames.append(packed)
            self._bytes += len(packed.jpeg)
            while self._bytes > self._limit or t - self._frames[0].t > self._span:
                self._bytes -= len(self._frames.popleft().jpeg)
                if not self._frames:
                    break
        return True

    def ask(self) -> Sequence[KeptFrame]:
        """Return what is kept, oldest first; from now on the ring stands still for a while (see ``TOUCHED``)."""
        with self._lock:
            self._held = self._now if self._held is None else self._held
            self._until = min(self._now + TOUCHED, self._held + LONGEST_STILL)
            return tuple(self._frames)

    def clear(self) -> None:
        """Forget all pictures."""
        with self._lock:
            self._drop_all()
            self._held = None

    def _drop_all(self) -> None:
        self._frames.clear()
        self._bytes = 0


def shrunk(image: Image) -> Image:
    """Return a picture no wider than the ring's."""
    height, width = image.shape[:2]
    if width <= WIDTH:
        return image
    small = (WIDTH, max(round(height * WIDTH / width), 1))
    return cast(Image, cv2.resize(image, small, interpolation=cv2.INTER_AREA))


def _pack(image: Image) -> bytes:
    _, packed = cv2.imencode(".jpg", shrunk(image), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return packed.tobytes()
