"""A world that happens now: its blocks are made ahead by one thread, its arrivals handed out when their time comes.

Where the machine makes the world more slowly than it happens, the world stands still until the next block is there:
everything after is later by as much, and no less true. A world that is tied to a real camera's clip cannot wait; what
is too late of it is left out.
"""

from __future__ import annotations

import dataclasses
import heapq
import itertools
import threading
import time
from collections.abc import Callable, Iterator

import msgspec

from services.simulator.people import BLOCK
from services.simulator.phones.phone_batch import PhoneBatch
from services.simulator.world import Arrival, World, WorldBlock, truth_messages
from shared.messages import DetectionFrame
from shared.truth import GroundTruth

__all__ = ["Happening", "LiveWorld"]

Happening = DetectionFrame | PhoneBatch | GroundTruth

JUST_NOW = 2.0
"""Seconds: what happened so shortly ago is told late rather than not at all."""
AHEAD = 2.0 * BLOCK
"""Seconds of world that exist before they happen."""
WELL_AGAIN = 6
"""Blocks in a row made in time, after which the world is said to keep up."""
SLOW = "the world is made more slowly than it happens: it stands still now and then (this machine is too busy)"
SLOW_CLIP = "the world is made more slowly than its clip is played: parts are left out (this machine is too busy)"


class LiveWorld:
    """A world and the clock it follows.

    Args:
        world: not made yet.
        epoch: true time of the world's second zero.
        tied: whether the epoch is a real camera's, so that the world may not wait.
        report: called with a reason in plain words when the machine is too slow, and with None when it keeps up.
        clock: tells the true time.

    Attributes:
        delay: seconds the world has stood still so far.
    """

    def __init__(
        self,
        world: World,
        epoch: float,
        *,
        tied: bool = False,
        report: Callable[[str | None], None] = lambda reason: None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        self.world = world
        self.delay = 0.0
        self._epoch = epoch
        self._tied = tied
        self._report = report
        self._clock = clock
        self._begun = False
        self._exists = 0.0  # world seconds made, as of the present delay
        self._in_time = 0
        self._heap: list[tuple[float, int, Happening]] = []
        self._order = itertools.count()
        self._lock = threading.Lock()

    def now(self) -> float:
        """Return seconds since the epoch."""
        return self._clock() - self._epoch

    def world_time(self, t: float) -> float:
        """Return the world's second that is shown ``t`` seconds after the epoch: never one that is not made yet.

        Until a late block is there the world stands still at its end; where that block begins, it goes on.
        """
        with self._lock:
            return min(max(0.0, t - self.delay), self._exists)

    def play(self, stopping: threading.Event) -> Iterator[Arrival[Happening]]:
        """Yield what happens at the moment it happens, until ``stopping``, which ends it within a tenth of a second.

        All times, within messages too, are seconds since the epoch: world time and as long as the world stood still.
        """
        ended = threading.Event()
        maker = threading.Thread(target=self._make, args=(stopping, ended), name="world", daemon=True)
        maker.start()
        try:
            while not stopping.is_set():
                arrival = self.due()
                if arrival is None:
                    stopping.wait(0.01)
                else:
                    yield arrival
        finally:
            ended.set()
            maker.join(timeout=2.0)

    def due(self) -> Arrival[Happening] | None:
        """Return the earliest that has happened by now and was not returned yet; None while there is none."""
        now = self.now()
        with self._lock:
            while self._heap and self._heap[0][0] <= now:
                t, _, message = heapq.heappop(self._heap)
                # A clip that runs already is joined in its middle.
                if not self._tied or t >= now - JUST_NOW:
                    return Arrival(t, message)
        return None

    def make_ahead(self) -> bool:
        """Make the next block if it is time to; whether it was."""
        # Where nobody takes what has happened, no more is made: it would only wait.
        if self.world.made + self.delay > self.now() + AHEAD or self._overdue() > BLOCK:
            return False
        block = self.world.next_block()
        self._keep_pace(block)
        happenings: list[tuple[float, Happening]] = [*block.frames]
        happenings += [(batch.arrival, batch) for batch in block.batches]
        happenings += [(truth.t, truth) for truth in truth_messages(self.world, block)]
        with self._lock:
            self._exists = block.end
            for t, message in happenings:
                heapq.heappush(self._heap, (t + self.delay, next(self._order), _put_off(message, self.delay)))
        return True

    def _make(self, stopping: threading.Event, ended: threading.Event) -> None:
        while not (stopping.is_set() or ended.is_set()):
            if not self.make_ahead():
                ended.wait(0.1)

    def _keep_pace(self, block: WorldBlock) -> None:
        """Let the world stand still until a block that was made too late can begin; tell when that is no start-up."""
        late = self.now() - block.start - self.delay
        if late > (JUST_NOW if self._tied else 0.0):
            self._in_time = 0
            if self._begun:
                self._report(SLOW_CLIP if self._tied else SLOW)
        else:
            self._begun = True
            self._in_time += 1
            if self._in_time >= WELL_AGAIN:
                self._report(None)
        if late > 0.0 and not self._tied:
            self._begun = True
            with self._lock:
                self.delay += late

    def _overdue(self) -> float:
        with self._lock:
            return self.now() - self._heap[0][0] if self._heap else 0.0


def _put_off(message: Happening, by: float) -> Happening:
    """Return what happened as if it had happened ``by`` seconds later."""
    if by == 0.0:
        return message
    if not isinstance(message, PhoneBatch):
        return msgspec.structs.replace(message, t=message.t + by)
    inertial = message.inertial
    return dataclasses.replace(
        message,
        measured_until=message.measured_until + by,
        sent=message.sent + by,
        arrival=message.arrival + by,
        inertial=None if inertial is None else dataclasses.replace(inertial, t=inertial.t + by),
        scans=tuple(dataclasses.replace(scan, t=scan.t + by) for scan in message.scans),
        step_t=message.step_t + by,
    )
