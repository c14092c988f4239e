"""What a tracker is: the contract every tracker meets.

A tracker is a pure state machine: no clock, no bus, no file. The same chunks give the same frames, to the byte; a
tracker restored from ``state()`` goes on exactly as the one that gave it. ``tests/contract/test_trackers.py`` holds
every tracker of ``services.fusion.registry`` to this.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from services.fusion.area_view import AreaView
from shared.messages import (
    DetectionFrame,
    Erasure,
    MotionBatch,
    RadioModelUpdate,
    RadioScan,
    Revision,
    TrackFrame,
)

__all__ = ["Chunk", "Complaining", "Retuning", "Tracker", "TrackerStateError"]


@dataclass(frozen=True, slots=True)
class Chunk:
    """What fusion consumes at once, each kind in the order it was consumed.

    Attributes:
        index: number of the chunk since the epoch; grows, not always by one.
        t_start: where its time begins, seconds since the epoch.
        t_end: where it ends, exclusive.
        frames: what the cameras saw; a late frame may be older than ``t_start``.
        scans: radio scans that arrived since the chunk before, whatever their own time.
        motions: motion batches, likewise.
        erasures: who withdrew consent.
        models: radio models that went live; whoever steps a tracker swaps its radio first (``active_radio``).
    """

    index: int
    t_start: float
    t_end: float
    frames: tuple[DetectionFrame, ...] = ()
    scans: tuple[RadioScan, ...] = ()
    motions: tuple[MotionBatch, ...] = ()
    erasures: tuple[Erasure, ...] = ()
    models: tuple[RadioModelUpdate, ...] = ()


class TrackerStateError(ValueError):
    """A saved state does not belong to this tracker: the text says what was expected."""


class Tracker(Protocol):
    """Who is where after each chunk."""

    name: str
    cycle: float
    """Seconds a chunk lasts that it wants to be stepped with (``chunks.period_of``); 0 means the usual 1/15 s."""

    def step(self, chunk: Chunk) -> TrackFrame:
        """Consume one chunk and return everybody; what cannot be used is ignored, never an error."""
        ...

    def revision(self) -> Revision | None:
        """Return where the last step changed what the steps before it had said; None where it changed nothing."""
        ...

    def ignored(self) -> dict[str, int]:
        """Return how much could not be used so far, by reason in plain words."""
        ...

    def snapshot(self) -> Callable[[], bytes]:
        """Copy all the tracker knows, in little time; calling the result encodes the copy, in whatever thread."""
        ...

    def state(self) -> bytes:
        """Return all the tracker knows, as JSON: a snapshot, encoded."""
        ...

    def restore(self, state: bytes) -> None:
        """Go on from what ``state()`` of a tracker of the same name returned.

        Raises:
            TrackerStateError: the bytes are no such state; the tracker is then unchanged.
        """
        ...


@runtime_checkable
class Complaining(Protocol):
    """A tracker that finds out what is wrong with its sensors; none has to."""

    def complaints(self) -> list[str]:
        """Return, in plain words for the health page, what is wrong now: a camera's clock, say."""
        ...


@runtime_checkable
class Retuning(Protocol):
    """A tracker that goes on under another radio model; one that does not keeps the model it was made with."""

    def retune(self, view: AreaView) -> None:
        """Go on under the radio of ``view``, the same area but for ``radio`` and ``shadowing``.

        Positions, tracks and names stay. What was learned of the old model's errors is corrected by how the two models
        differ, or forgotten: a model that was learned meanwhile has been taught by the same readings, which must not
        count twice. Under a model that says the same nothing changes, to the byte.
        """
        ...
