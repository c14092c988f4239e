"""The process that tries models: one job from standard input, one answer to standard output, at the lowest priority."""

from __future__ import annotations

import os
import pickle
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec

from services.fusion.area_view import AreaView
from services.fusion.rescore.quality import Score, total
from services.fusion.rescore.recent import decode_chunk
from services.fusion.rescore.trial import LEAST_SCANS, run_trial, withhold

__all__ = ["Answer", "DeviceAnswer", "Job", "answer", "too_few"]

NICE = 15


@dataclass(frozen=True)
class Job:
    """What is to be tried; ``candidate`` None where only the active model is scored."""

    chunks: Sequence[bytes]
    tracker: str
    seed: int
    active: AreaView
    candidate: AreaView | None
    scale: dict[str, float]


class DeviceAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """Nats per withheld reading, of one device."""

    scans: int
    active: float
    candidate: float | None = None
    gain: float | None = None


class Answer(msgspec.Struct, frozen=True, kw_only=True):
    """What fusion answers; ``error`` alone where nothing could be tried.

    Scores are nats per withheld reading beyond a model that knows no places; ``gain`` is candidate minus active.
    ``named``: share of withheld readings made while a track carried the device's name.
    """

    error: str | None = None
    scans: int = 0
    seconds: float = 0.0
    active: float = 0.0
    active_named: float = 0.0
    candidate: float | None = None
    candidate_named: float | None = None
    gain: float | None = None
    devices: dict[str, DeviceAnswer] = {}
    took: float = 0.0


def answer(job: Job) -> Answer:
    """Score the active model and the candidate."""
    began = time.perf_counter()
    chunks = [decode_chunk(packed) for packed in job.chunks]
    kept, withheld, seconds = withhold(chunks, job.active.radio.names)
    scans = sum(one.scans for one in withheld.values())
    if scans < LEAST_SCANS:
        return Answer(error=too_few(scans))
    active = run_trial(kept, withheld, job.active, job.tracker, job.seed, {})
    candidate = None
    if job.candidate is not None:
        candidate = run_trial(kept, withheld, job.candidate, job.tracker, job.seed, job.scale)
    overall = total(list(active.values()))
    other = None if candidate is None else total(list(candidate.values()))
    return Answer(
        scans=scans,
        seconds=seconds,
        active=overall.per_reading,
        active_named=_named(overall),
        candidate=None if other is None else other.per_reading,
        candidate_named=None if other is None else _named(other),
        gain=None if other is None else other.per_reading - overall.per_reading,
        devices={
            device: _of_device(one.scans, active[device], None if candidate is None else candidate[device])
            for device, one in withheld.items()
        },
        took=time.perf_counter() - began,
    )


def too_few(scans: int) -> str:
    """Return why nothing can be said of so few withheld scans."""
    return f"scans: found {scans} to withhold in the last minutes; allowed: {LEAST_SCANS} or more"


def _of_device(scans: int, active: Score, candidate: Score | None) -> DeviceAnswer:
    if candidate is None:
        return DeviceAnswer(scans=scans, active=active.per_reading)
    gain = candidate.per_reading - active.per_reading
    return DeviceAnswer(scans=scans, active=active.per_reading, candidate=candidate.per_reading, gain=gain)


def _named(score: Score) -> float:
    return score.named / score.readings if score.readings else 0.0


if __name__ == "__main__":
    os.nice(NICE)
    # From our own parent process, over a pipe nobody else holds.
    sys.stdout.buffer.write(msgspec.json.encode(answer(pickle.loads(sys.stdin.buffer.read()))))  # noqa: S301
