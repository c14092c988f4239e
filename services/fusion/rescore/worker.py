"""The process that tries models: one job from standard input, one answer to standard output, at the lowest priority."""

from __future__ import annotations

import os
import pickle
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from services.fusion.area_view import AreaView
from services.fusion.registry import DEFAULT_TRACKER
from services.fusion.rescore.candidate import CandidateError, apply, read_candidate
from services.fusion.rescore.quality import Score, total
from services.fusion.rescore.recent import decode_chunk
from services.fusion.rescore.setting import Asked
from services.fusion.rescore.sight import Sight
from services.fusion.rescore.significance import gain_error, rate_error
from services.fusion.rescore.trial import LEAST_SCANS, Held, Paths, run_trial, score, withhold
from services.fusion.tracker import Chunk

__all__ = ["Answer", "DeviceAnswer", "Job", "SightAnswer", "answer", "by_radio", "judge", "rescore", "too_few"]

NICE = 15


@dataclass(frozen=True)
class Job:
    """A question and what it is about: chunks as ``RecentChunks`` keeps them, the area under the active model."""

    chunks: Sequence[bytes]
    tracker: str
    seed: int
    view: AreaView
    question: bytes


class DeviceAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """Nats per withheld reading, of one device."""

    scans: int
    active: float
    candidate: float | None = None
    gain: float | None = None


class SightAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """The cumulative quality score of both sides, nats per second of the time scored.

    ``tracks`` are those of high quality, ``people`` how many of them there were at a time, in the mean.
    """

    active: float
    active_tracks: int
    active_people: float
    candidate: float | None = None
    candidate_tracks: int | None = None
    candidate_people: float | None = None
    gain: float | None = None
    gain_error: float | None = None


class Answer(msgspec.Struct, frozen=True, kw_only=True):
    """What fusion answers; ``error`` alone where nothing could be tried.

    Scores are nats per withheld reading beyond a model that knows no places; ``gain`` is candidate minus active and
    ``gain_error`` its standard error. ``tracks_gain`` is what the candidate's tracks gain on the active model's where
    both models judge, each for half: a model is not praised for itself then, only for where it puts people. ``named``:
    share of withheld readings made while a track carried the device's name. Where cameras are asked about, too few
    readings leave the gains open instead of being an error.
    """

    error: str | None = None
    scans: int = 0
    seconds: float = 0.0
    active: float = 0.0
    active_named: float = 0.0
    candidate: float | None = None
    candidate_named: float | None = None
    gain: float | None = None
    gain_error: float | None = None
    tracks_gain: float | None = None
    tracks_gain_error: float | None = None
    sight: SightAnswer | None = None
    devices: dict[str, DeviceAnswer] = {}
    took: float = 0.0


def rescore(
    question: bytes, chunks: Iterable[Chunk], view: AreaView, tracker: str = DEFAULT_TRACKER, seed: int = 0
) -> dict[str, Any]:
    """Answer a question as fusion does over the bus, in this process and at once.

    Args:
        question: the candidate, JSON.
        chunks: what was consumed, oldest first.
        view: the area under the active model.
        tracker: name of the tracker.
        seed: of it.
    """
    told: dict[str, Any] = msgspec.to_builtins(_answer(question, chunks, view, tracker, seed))
    return told


def answer(job: Job) -> Answer:
    """Do a job."""
    chunks = (decode_chunk(packed) for packed in job.chunks)
    return _answer(job.question, chunks, job.view, job.tracker, job.seed)


def _answer(question: bytes, chunks: Iterable[Chunk], view: AreaView, tracker: str, seed: int) -> Answer:
    began = time.perf_counter()
    try:
        asked = apply(read_candidate(question), view)
    except CandidateError as error:
        return Answer(error=str(error))
    told = judge(list(chunks), tracker, seed, asked)
    return msgspec.structs.replace(told, took=time.perf_counter() - began)


def judge(chunks: Sequence[Chunk], tracker: str, seed: int, asked: Asked) -> Answer:
    """Score the active model and the candidate."""
    held = withhold(chunks, asked.active.view.radio.names, asked.since, asked.until)
    if held.seconds <= 0.0 or (held.scans < LEAST_SCANS and not asked.sight):
        return Answer(error=too_few(held.scans))
    active, seen = run_trial(held, asked.active, tracker, seed, sight=asked.sight)
    candidate, would = None, None
    if asked.candidate is not None:
        candidate, would = run_trial(held, asked.candidate, tracker, seed, sight=asked.sight)
    told = by_radio(held, asked, active, candidate)
    return told if seen is None else msgspec.structs.replace(told, sight=_sight(held, seen, would))


def too_few(scans: int) -> str:
    """Return why nothing can be said of so few withheld scans."""
    return f"scans: found {scans} to withhold in the time asked about; allowed: {LEAST_SCANS} or more"


def by_radio(held: Held, asked: Asked, active: Paths, candidate: Paths | None) -> Answer:
    """Return what withheld readings and steps say of where the devices were under each side."""
    ours = score(held, asked.active, active)
    theirs = None if asked.candidate is None or candidate is None else score(held, asked.candidate, candidate)
    overall = total(list(ours.values()))
    told = Answer(
        scans=held.scans,
        seconds=held.seconds,
        active=overall.per_reading,
        active_named=_named(overall),
        devices={
            device: _of_device(one.scans, ours[device], None if theirs is None else theirs[device])
            for device, one in held.withheld.items()
        },
    )
    if asked.candidate is None or candidate is None or theirs is None:
        return told
    other = total(list(theirs.values()))
    told = msgspec.structs.replace(told, candidate=other.per_reading, candidate_named=_named(other))
    if held.scans < LEAST_SCANS:
        return told
    count = {(device, slot): readings for device, one in ours.items() for slot, readings in one.count.items()}
    by_active, by_candidate = score(held, asked.active, candidate), score(held, asked.candidate, active)
    gains = {block: _in(theirs, block) - _in(ours, block) for block in count}
    tracks = {
        block: 0.5 * (_in(by_active, block) - _in(ours, block) + _in(theirs, block) - _in(by_candidate, block))
        for block in count
    }
    return msgspec.structs.replace(
        told,
        gain=other.per_reading - overall.per_reading,
        gain_error=gain_error(gains, count),
        tracks_gain=sum(tracks.values()) / max(sum(count.values()), 1),
        tracks_gain_error=gain_error(tracks, count),
    )


def _in(scores: dict[str, Score], block: tuple[str, int]) -> float:
    return scores[block[0]].slots.get(block[1], 0.0)


def _sight(held: Held, active: Sight, candidate: Sight | None) -> SightAnswer:
    seconds = held.seconds
    told = SightAnswer(
        active=active.quality / seconds, active_tracks=active.tracks, active_people=active.lasted / seconds
    )
    if candidate is None:
        return told
    slots = {*active.slots, *candidate.slots}
    gains = {slot: candidate.slots.get(slot, 0.0) - active.slots.get(slot, 0.0) for slot in slots}
    return msgspec.structs.replace(
        told,
        candidate=candidate.quality / seconds,
        candidate_tracks=candidate.tracks,
        candidate_people=candidate.lasted / seconds,
        gain=(candidate.quality - active.quality) / seconds,
        gain_error=rate_error(gains, held.since, held.until),
    )


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
