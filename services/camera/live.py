"""Pictures as they happen: network streams and devices, always the newest, never a queue of old ones.

A thread of its own drains the stream, because an unread stream does not stop: its pictures pile up in buffers and get
older and older. What the reader has not fetched when the next picture arrives is overtaken, and counted.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import ClassVar, cast

import cv2

from services.camera.detector import Image
from services.camera.frames import Frame, SourceError
from services.camera.no_stream import why_no_stream
from shared.redaction import redact_url

__all__ = ["LiveSource"]

OPEN_TIMEOUT = 5.0
"""Seconds a stream may take to answer."""
READ_TIMEOUT = 5.0
"""Seconds a stream may be silent."""
CLOCK_STEP = 1.0
"""Seconds by which time must run backwards to be a clock that was set, and not the jitter of an adjusted one."""


class LiveSource:
    """A stream (RTSP, HTTP) or a device, drained by a thread while it is being read.

    Args:
        address: URL, or index of a device of this machine.
        latency: seconds between the light and the arrival of a picture.
    """

    live: ClassVar[bool] = True

    def __init__(self, address: str | int, latency: float = 0.0) -> None:
        self._address = address
        self._latency = latency
        self._overtaken = 0

    @property
    def overtaken(self) -> int:
        """Pictures dropped for newer ones since this source was made."""
        return self._overtaken

    def frames(self, stopping: threading.Event) -> Iterator[Frame]:
        """Yield the newest picture again and again; see the protocol."""
        drain = _Drain(self._address)
        drain.start()
        seq, origin, last, counted = 0, 0.0, 0.0, 0
        try:
            while not stopping.is_set():
                taken = drain.take(0.2)
                self._overtaken += drain.overtaken - counted
                counted = drain.overtaken
                if taken is None:
                    continue
                image, arrived = taken
                t = arrived - self._latency
                if not (t > last or last - t > CLOCK_STEP):
                    # An adjusted clock must not make time run backwards for those who read this; one that was set is
                    # followed at once, or time would stand still for as long as the clock was set back.
                    t = last + 1e-3
                last = t
                if seq == 0:
                    origin = t
                yield Frame(image=image, t=t, seq=seq, pass_origin=origin, arrived=arrived)
                seq += 1
        finally:
            drain.leave()


class _Drain(threading.Thread):
    """Opens the stream and holds its newest picture until it is taken or replaced."""

    def __init__(self, address: str | int) -> None:
        super().__init__(name="camera reader", daemon=True)
        self._address = address
        self._changed = threading.Condition()
        self._newest: tuple[Image, float] | None = None
        self._failure: SourceError | None = None
        self._leaving = False
        self.overtaken = 0

    def take(self, timeout: float) -> tuple[Image, float] | None:
        """Return (picture, arrival) once there is a new one, None after ``timeout`` s.

        Raises:
            SourceError: the stream failed.
        """
        with self._changed:
            if self._newest is None and self._failure is None:
                self._changed.wait(timeout)
            newest, self._newest = self._newest, None
            if newest is None and self._failure is not None:
                raise self._failure
            return newest

    def leave(self) -> None:
        """Let the thread end; it does so within the read timeout, nobody needs to wait."""
        self._leaving = True

    def run(self) -> None:
        """Read until told to leave or the stream fails."""
        try:
            self._read()
        except SourceError as error:
            failure = error
        except cv2.error as error:
            failure = SourceError(f"{_name(self._address)} sends what is no picture: {error.err}")
        except Exception as error:  # whoever waits for pictures must hear of it
            failure = SourceError(f"{_name(self._address)} cannot be read: {type(error).__name__}")
        else:
            return
        with self._changed:
            self._failure = failure
            self._changed.notify()

    def _read(self) -> None:
        capture = _open(self._address)
        try:
            while not self._leaving:
                good, image = capture.read()
                if not good:
                    if self._leaving:
                        return
                    raise SourceError(f"{_name(self._address)} stopped sending pictures")
                arrived = time.time()
                with self._changed:
                    if self._newest is not None:
                        self.overtaken += 1
                    self._newest = (cast(Image, image), arrived)
                    self._changed.notify()
        finally:
            capture.release()


def _open(address: str | int) -> cv2.VideoCapture:
    if isinstance(address, int):
        capture = cv2.VideoCapture(address)
        if not capture.isOpened():
            raise SourceError(f"there is no camera device {address} on this machine, or another program uses it")
        return capture
    timeouts = [
        cv2.CAP_PROP_OPEN_TIMEOUT_MSEC,
        round(1000 * OPEN_TIMEOUT),
        cv2.CAP_PROP_READ_TIMEOUT_MSEC,
        round(1000 * READ_TIMEOUT),
    ]
    capture = cv2.VideoCapture(address, cv2.CAP_FFMPEG, timeouts)
    if not capture.isOpened():
        raise SourceError(f"{_name(address)} gives no video: {why_no_stream(address)}")
    return capture


def _name(address: str | int) -> str:
    return f"camera device {address}" if isinstance(address, int) else f"the stream {redact_url(address)}"
