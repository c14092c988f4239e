"""Pictures out of files: a video, or a folder of pictures in the order of their names."""

from __future__ import annotations

import re
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar, Literal, cast

import cv2
import structlog

from services.camera.detector import Image
from services.camera.frames import Frame, SourceError

__all__ = ["FolderSource", "VideoFile"]

PICTURES = frozenset({".bmp", ".jpeg", ".jpg", ".png", ".ppm", ".tif", ".tiff", ".webp"})
COMPLETE = 0.95
"""A video that ends before this share of what its header promises is damaged (headers are often off by a little)."""

log = structlog.get_logger(__name__)


class _Recorded(ABC):
    """What files have in common: a clock of their own, and passes."""

    live: ClassVar[bool] = False
    overtaken = 0

    def __init__(self, path: Path, pace: Literal["source", "fast"], frames_per_s: float | None, loop: bool) -> None:
        self._path = path
        self._pace = pace
        self._frames_per_s = frames_per_s
        self._loop = loop

    def frames(self, stopping: threading.Event) -> Iterator[Frame]:
        """Yield the pictures of one pass, or of pass after pass; see the protocol."""
        origin = time.time()
        # Waiting goes by a clock nobody can set; what is told stays origin + seq / rate.
        begun = ended = time.monotonic()
        while not stopping.is_set():
            seq = 0
            rate = 0.0
            for rate, image in self._pictures():
                if seq == 0:
                    # A new pass never begins before the last one ended, also when that one ran ahead of the clock.
                    origin = max(origin, time.time())
                    begun = max(ended, time.monotonic())
                t = origin + seq / rate
                if self._pace == "source":
                    stopping.wait(max(begun + seq / rate - time.monotonic(), 0.0))
                if stopping.is_set():
                    return
                yield Frame(image=image, t=t, seq=seq, pass_origin=origin, arrived=time.time())
                seq += 1
            if not self._loop:
                return
            origin += seq / rate
            ended = begun + seq / rate

    @abstractmethod
    def _pictures(self) -> Iterator[tuple[float, Image]]:
        """Yield (frames per second, picture) of one pass, at least one.

        Raises:
            SourceError: there is none, or the file is damaged.
        """


class VideoFile(_Recorded):
    """A video file.

    Args:
        path: any container FFmpeg reads.
        pace: ``source`` plays it by the clock, ``fast`` as fast as pictures are asked for.
        frames_per_s: overrides what the file says of itself.
        loop: begin again at the end.
    """

    def __init__(
        self,
        path: Path,
        *,
        pace: Literal["source", "fast"] = "source",
        frames_per_s: float | None = None,
        loop: bool = False,
    ) -> None:
        super().__init__(path, pace, frames_per_s, loop)

    def _pictures(self) -> Iterator[tuple[float, Image]]:
        if not self._path.is_file():
            raise SourceError(f"the video file {self._path} does not exist")
        capture = cv2.VideoCapture(str(self._path), cv2.CAP_FFMPEG)
        try:
            if not capture.isOpened():
                raise SourceError(f"{self._path} cannot be read as a video: it is damaged or of an unknown format")
            rate = self._frames_per_s or capture.get(cv2.CAP_PROP_FPS)
            if not 0.0 < rate <= 240.0:
                raise SourceError(
                    f"{self._path} does not say how many pictures per second it has; set frames_per_s in the site file",
                    retry=False,
                )
            promised = capture.get(cv2.CAP_PROP_FRAME_COUNT)
            count = 0
            while True:
                good, image = capture.read()
                if not good:
                    break
                count += 1
                yield rate, cast(Image, image)
            if count == 0:
                raise SourceError(f"{self._path} holds no readable picture: it is damaged")
            if count < COMPLETE * promised:
                raise SourceError(
                    f"{self._path} is damaged: it ends after {count} of {promised:.0f} pictures", retry=False
                )
        finally:
            capture.release()


class FolderSource(_Recorded):
    """A folder of pictures, played in the order of their names (numbers in them count as numbers).

    Args:
        path: the folder.
        pace: as for a video file.
        frames_per_s: pictures per second.
        loop: begin again at the end.
    """

    def __init__(
        self, path: Path, *, pace: Literal["source", "fast"] = "source", frames_per_s: float, loop: bool = False
    ) -> None:
        super().__init__(path, pace, frames_per_s, loop)

    def _pictures(self) -> Iterator[tuple[float, Image]]:
        try:
            files = [file for file in self._path.iterdir() if file.suffix.lower() in PICTURES]
        except OSError as error:
            raise SourceError(f"the folder {self._path} cannot be read: {error.strerror}") from error
        readable = 0
        for file in sorted(files, key=_by_number):
            image = cv2.imread(str(file), cv2.IMREAD_COLOR)
            if image is None:
                # To leave it out would shift the time of all later pictures.
                raise SourceError(f"the picture {file} cannot be read: it is damaged", retry=False)
            readable += 1
            yield self._frames_per_s or 1.0, cast(Image, image)
        if not readable:
            raise SourceError(f"the folder {self._path} holds no pictures ({', '.join(sorted(PICTURES))})")


def _by_number(file: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", file.name)]
