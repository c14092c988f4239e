"""What is a picture, and what is a place that pictures come from? The protocol every source meets.

A recorded source (file, folder) has a clock of its own: picture n of a pass was taken at the pass's origin + n / rate.
A live source (stream, device) has only arrivals: a picture was taken a configured latency before it arrived.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Protocol

from services.camera.detector import Image

__all__ = ["Frame", "Source", "SourceError"]


class SourceError(RuntimeError):
    """No (more) pictures come: one sentence for an operator, passwords hidden.

    Attributes:
        retry: whether trying again later can help.
    """

    def __init__(self, sentence: str, *, retry: bool = True) -> None:
        super().__init__(sentence)
        self.retry = retry


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One picture.

    Attributes:
        image: (height, width, 3), blue-green-red.
        t: when it was taken, seconds since the epoch.
        seq: its number in this pass, from 0; a live source counts what it delivers, not what was overtaken.
        pass_origin: ``t`` of the first picture of this pass (of the file, or since the stream was opened).
        arrived: wall-clock time at which it reached this process.
    """

    image: Image
    t: float
    seq: int
    pass_origin: float
    arrived: float


class Source(Protocol):
    """A place that pictures come from."""

    live: ClassVar[bool]
    """Live sources never end: they fail, and are opened again."""

    @property
    def overtaken(self) -> int:
        """How many pictures were dropped because a newer one arrived before they were asked for."""
        ...

    def frames(self, stopping: threading.Event) -> Iterator[Frame]:
        """Open the source and yield its pictures until it ends or ``stopping`` is set.

        Their ``t`` grows, but where the clock of a live source's machine is set back by more than a second.

        Raises:
            SourceError: it cannot be opened, or it fails later; calling again tries again.
        """
        ...
