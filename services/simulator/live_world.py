"""A world that happens now: its blocks are made ahead by one thread, its arrivals handed out when their time comes."""

from __future__ import annotations

import heapq
import itertools
import threading
import time
from collections.abc import Iterator

import structlog

from services.simulator.people import BLOCK
from services.simulator.phone_batch import PhoneBatch
from services.simulator.world import Arrival, World, WorldBlock, truth_messages
from shared.messages import DetectionFrame
from shared.truth import GroundTruth

__all__ = ["play"]

log = structlog.get_logger(__name__)

JUST_NOW = 2.0
"""Seconds: what happened so shortly before the play began is told late rather than not at all."""
AHEAD = 2.0 * BLOCK
"""Seconds of world that exist before they happen."""


def play(
    world: World, epoch: float, stopping: threading.Event
) -> Iterator[Arrival[DetectionFrame | PhoneBatch | GroundTruth]]:
    """Yield what happens in ``world`` at the moment it happens, until ``stopping``.

    What happened long before now is skipped: a clip that runs already is joined in its middle.

    Args:
        world: not made yet.
        epoch: true time of the world's second zero.
        stopping: ends the play within a tenth of a second.
    """
    waiting = _Waiting(world, epoch, stopping)
    maker = threading.Thread(target=waiting.make, name="world", daemon=True)
    maker.start()
    begun = time.time() - epoch - JUST_NOW
    try:
        while not stopping.is_set():
            arrival = waiting.due(time.time() - epoch)
            if arrival is None:
                stopping.wait(0.01)
            elif arrival.t >= begun:
                yield arrival
    finally:
        waiting.ended.set()
        maker.join(timeout=2.0)


class _Waiting:
    """What has been made and not happened yet."""

    def __init__(self, world: World, epoch: float, stopping: threading.Event) -> None:
        self._world = world
        self._epoch = epoch
        self._stopping = stopping
        self._heap: list[tuple[float, int, DetectionFrame | PhoneBatch | GroundTruth]] = []
        self._order = itertools.count()
        self._lock = threading.Lock()
        self.ended = threading.Event()

    def make(self) -> None:
        """Make block after block, ahead of the clock, until the play has ended."""
        late = False
        while not (self._stopping.is_set() or self.ended.is_set()):
            now = time.time() - self._epoch
            if self._world.made > now + AHEAD:
                self.ended.wait(0.1)
                continue
            self._take(self._world.next_block())
            behind = time.time() - self._epoch - self._world.made
            if behind > 0.0 and not late and self._world.made > now:
                log.warning("the world is made more slowly than it happens", behind_s=round(behind, 1))
                late = True

    def _take(self, block: WorldBlock) -> None:
        with self._lock:
            for t, frame in block.frames:
                heapq.heappush(self._heap, (t, next(self._order), frame))
            for batch in block.batches:
                heapq.heappush(self._heap, (batch.arrival, next(self._order), batch))
            for truth in truth_messages(self._world, block):
                heapq.heappush(self._heap, (truth.t, next(self._order), truth))

    def due(self, now: float) -> Arrival[DetectionFrame | PhoneBatch | GroundTruth] | None:
        """Return the earliest that has happened by ``now``; None while there is none."""
        with self._lock:
            if not self._heap or self._heap[0][0] > now:
                return None
            t, _, message = heapq.heappop(self._heap)
        return Arrival(t, message)
