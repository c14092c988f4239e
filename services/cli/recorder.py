"""``atrium record``: write what fusion may consume, its marks and its tracks to an MCAP file until told to stop."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec

from services.cli.recording import INPUT_KINDS, STATE_KINDS, TOPICS, RecordingWriter
from shared.bus import DROPPED, Bus, Delivery
from shared.keys import Keys
from shared.messages import ChunkMark, Message
from shared.site import Site

__all__ = ["record"]

QUEUE = 200_000
SETTLE = 1.0
"""Seconds after which a mark's inputs have arrived if they ever will."""
GIVE_UP = 60.0
"""Seconds after which a recording that cannot be made whole is left as it is; verifying it then says so."""
WATCH = 10.0
"""Seconds for which a stored state is doubted; fusion holds phones' messages back for five at most."""


class _State(msgspec.Struct):
    chunk: int


def record(
    bus: Bus,
    site: Site,
    site_file: Path,
    out: Path,
    stopping: threading.Event,
    progress: Callable[[dict[str, int]], None] = lambda counts: None,
) -> dict[str, int]:
    """Record the site's bus into ``out`` until ``stopping`` is set.

    When fusion is already running its state is stored too, as soon as fusion consumes nothing that was sent before the
    recording began: from there on the recording replays exactly.

    Returns:
        How many messages of each kind were written, and ``dropped``, how many the recorder could not keep.
    """
    keys = Keys(site.site)
    inbox = bus.inbox(capacity=QUEUE)
    lost_before = _lost()
    for kind, key_of in TOPICS.items():
        inbox.subscribe(key_of(keys), kind, cached=kind in STATE_KINDS)
    with RecordingWriter(out, site.site, site_file.resolve()) as writer:
        running = list(_states(bus, keys.fusion_state()))
        for area, answer, state in running:
            if state.chunk < 0:  # nothing consumed yet: its answer still names tracker and seed
                writer.attach_state(area, answer, time.time())
        joining = _Joining({area: state.chunk for area, _, state in running})
        next_report = 0.0
        while True:
            last_round = stopping.is_set()
            for delivery in inbox.receive(timeout=0.2):
                writer.write(delivery.key, delivery.message, delivery.trace)
                joining.take(delivery)
            for area in joining.areas_to_ask(time.monotonic()):
                for _, answer, state in _states(bus, keys.fusion_state(area)):
                    writer.attach_state(area, answer, time.time())
                    joining.asked(area, state.chunk)
            if time.monotonic() >= next_report:
                next_report = time.monotonic() + 1.0
                progress(dict(writer.counts))
            if last_round:
                break
        dropped = int(_lost() - lost_before)
        writer.close(dropped)
        return {**writer.counts, "dropped": dropped}


class _Joining:
    """From which chunk on does the recording hold all that fusion consumes?

    Fusion may hold back a phone's scan for seconds, so the first chunks after the recorder's start can name messages
    sent before it. Once a chunk's inputs are all held the tracker's state is worth asking for; a later chunk that still
    names an unknown message makes that state worthless, and it is asked for again.

    Args:
        running: area → last closed chunk of the fusion processes that run already; −1 is one that has not begun.
    """

    def __init__(self, running: dict[str, int]) -> None:
        self._state: dict[str, int | None] = {area: None for area, chunk in running.items() if chunk >= 0}
        self._held: set[str] = set()
        self._marks: deque[tuple[float, ChunkMark]] = deque()
        self._settled_at = time.monotonic() + GIVE_UP if self._state else 0.0

    def take(self, delivery: Delivery[Message]) -> None:
        """Note what has been recorded."""
        if time.monotonic() > self._settled_at:
            self._held.clear()
            self._marks.clear()
        elif isinstance(delivery.message, ChunkMark):
            self._marks.append((time.monotonic(), delivery.message))
        elif isinstance(delivery.message, INPUT_KINDS):
            self._held.add(delivery.trace.id)

    def areas_to_ask(self, now: float) -> list[str]:
        """Return the areas whose state is worth asking for now."""
        wanted = []
        while self._marks and self._marks[0][0] + SETTLE <= now:  # by now its inputs have arrived if they ever will
            _, mark = self._marks.popleft()
            if mark.area not in self._state:
                continue
            state = self._state[mark.area]
            whole = all(trace in self._held for trace in mark.consumed)
            if whole and state is None and mark.area not in wanted:
                wanted.append(mark.area)
            elif not whole and state is not None and mark.chunk > state:
                self._state[mark.area] = None
        return wanted

    def asked(self, area: str, chunk: int) -> None:
        """Note that the state after ``chunk`` is stored."""
        self._state[area] = chunk
        if all(state is not None for state in self._state.values()):
            self._settled_at = time.monotonic() + WATCH


def _states(bus: Bus, key: str) -> Iterator[tuple[str, bytes, _State]]:
    for answered, payload in bus.ask(key, timeout=2.0):
        yield answered.split("/")[-2], payload, msgspec.json.decode(payload, type=_State)


def _lost() -> float:
    return sum(
        sample.value for metric in DROPPED.collect() for sample in metric.samples if sample.name.endswith("_total")
    )
