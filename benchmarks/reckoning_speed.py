"""How many phones can one core follow in real time? Recorded walks through the gateway's dead reckoning, in groups."""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.mall_traces import NORTH, Trace, load_traces
from services.gateway.reckoning.dead_reckoning import DeadReckoner, InertialSamples, Walk
from shared.settings import data_folder

__all__ = ["GROUP", "group_speed", "measure", "walking"]

GROUP = 32
"""Phones whose batches are worked on at once."""
RATE = 100.0
WARM = 10
"""Seconds not timed: walking is recognised by then."""

Array = NDArray[np.float64]


def walking(trace: Trace, rate: float = RATE) -> Array:
    """Return a trace resampled at an even rate, as a phone sends it: time and nine channels, (n, 10)."""
    t = np.arange(trace.t[0], trace.t[-1], 1.0 / rate)
    samples = trace.samples()
    return np.column_stack([t - t[0], *(np.interp(t, samples[:, 0], column) for column in samples.T[1:])])


def batches(recording: Array, rate: float = RATE) -> Iterator[InertialSamples]:
    """Yield a recording second by second, again and again, its time going on."""
    count = int(rate)
    seconds = len(recording) // count
    for k in itertools.count():
        part = recording[(k % seconds) * count : (k % seconds + 1) * count]
        t = part[:, 0] + (k // seconds) * seconds
        yield InertialSamples(t, part[:, 1:4], part[:, 4:7], part[:, 7:10])


def group_speed(recordings: Sequence[Array], phones: int, seconds: int) -> tuple[float, int]:
    """Return how many phones one core follows in real time, and the bytes of memory of the largest state.

    Args:
        recordings: who walks, taken in turn.
        phones: in a group.
        seconds: timed.
    """
    reckoner = DeadReckoner(NORTH)
    walks = [Walk("hand" if k % 2 else "unknown") for k in range(phones)]
    sources = [batches(recordings[k % len(recordings)]) for k in range(phones)]
    waiting = [[next(source) for source in sources] for _ in range(WARM + seconds)]
    for samples in waiting[:WARM]:
        reckoner.advance(walks, samples)
    begin = time.process_time()
    for samples in waiting[WARM:]:
        reckoner.advance(walks, samples)
    return phones * seconds / (time.process_time() - begin), max(walk.nbytes for walk in walks)


def measure() -> dict[str, float]:
    """Return the figures: phones at 100 Hz in groups and alone, by processor time, and the state of a phone."""
    recordings = [walking(trace) for trace in load_traces(data_folder())[:GROUP]]
    grouped = [group_speed(recordings, GROUP, 20) for _ in range(5)]
    alone = [group_speed(recordings, 1, 60) for _ in range(5)]
    return {
        "phones_realtime_100hz": float(np.median([speed for speed, _ in grouped])),
        "phones_realtime_100hz_alone": float(np.median([speed for speed, _ in alone])),
        "state_bytes": float(max(size for _, size in grouped)),
    }


if __name__ == "__main__":
    sys.stdout.write("".join(f"{name}: {value:.4g}\n" for name, value in measure().items()))
