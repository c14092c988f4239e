"""What fusion made of a recording, computed anew: the same chunks in the same order give the same bytes."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from services.fusion.area_view import AreaView
from services.fusion.registry import DEFAULT_TRACKER, make_tracker
from services.fusion.tracker import Chunk, TrackerStateError
from services.fusion.trained_view import trained_view
from shared.messages import (
    ChunkMark,
    DetectionFrame,
    Erasure,
    Message,
    MotionBatch,
    RadioScan,
    Revision,
    TrackFrame,
)
from shared.site import Site

__all__ = ["StateAnswer", "check_radio", "chunk_of", "radio_digest", "replay_steps", "replay_tracks"]


class StateAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """What fusion answers when asked for its state: the tracker as it was after one chunk."""

    chunk: int
    """Number of that chunk; −1 before the first."""
    tracker: str
    seed: int = 0
    radio: str = ""
    """``radio_digest`` of the area's radio; empty where whoever answered did not tell."""
    state: Any


def radio_digest(view: AreaView) -> str:
    """Return what tells one radio model from another: access points, their places, constants and shadowing."""
    radio, shadowing = view.radio, view.shadowing
    arrays = [radio.positions, radio.power_1m, radio.exponent]
    if shadowing is not None:
        arrays += [shadowing.origin, np.array(shadowing.cell), shadowing.mean, shadowing.variance]
    digest = hashlib.sha256(msgspec.json.encode(radio.names))
    for array in arrays:
        digest.update(np.ascontiguousarray(array, float).tobytes())
    return digest.hexdigest()


def check_radio(answer: StateAnswer, view: AreaView) -> None:
    """Refuse a state of another radio model: what the tracker learned of its errors would count twice.

    Raises:
        TrackerStateError: it is one.
    """
    if answer.radio and answer.radio != radio_digest(view):
        raise TrackerStateError(
            "a state of another radio model: the site file's access points or the trained model are others now"
        )


def chunk_of(mark: ChunkMark, inputs: Sequence[Message]) -> Chunk:
    """Return the chunk a mark closed; ``inputs`` are the messages it names, in its order."""
    return Chunk(
        index=mark.chunk,
        t_start=mark.t_start,
        t_end=mark.t_end,
        frames=tuple(message for message in inputs if isinstance(message, DetectionFrame)),
        scans=tuple(message for message in inputs if isinstance(message, RadioScan)),
        motions=tuple(message for message in inputs if isinstance(message, MotionBatch)),
        erasures=tuple(message for message in inputs if isinstance(message, Erasure)),
    )


def replay_tracks(
    chunks: Iterable[tuple[ChunkMark, Sequence[Message]]],
    site: Site,
    area: str,
    state: bytes | None = None,
    tracker: str = DEFAULT_TRACKER,
    seed: int = 0,
) -> Iterator[TrackFrame]:
    """Yield the tracks of each recorded chunk; see ``replay_steps``."""
    for frame, _ in replay_steps(chunks, site, area, state, tracker, seed):
        yield frame


def replay_steps(
    chunks: Iterable[tuple[ChunkMark, Sequence[Message]]],
    site: Site,
    area: str,
    state: bytes | None = None,
    tracker: str = DEFAULT_TRACKER,
    seed: int = 0,
    radio_model: Path | None = None,
) -> Iterator[tuple[TrackFrame, Revision | None]]:
    """Yield the tracks of each recorded chunk and what they revised, if anything.

    Args:
        chunks: each recorded mark with the messages it names, in its order.
        site: the site of the recording.
        area: whose chunks they are; other areas' are skipped.
        state: what fusion answered to the state query when the recording began. The tracker is then the one that
            answered; chunks up to that state are skipped. None: the recording began before fusion's first chunk.
        tracker: which tracker runs where there is no state.
        seed: its seed.
        radio_model: the trained model fusion had, if it had one.

    Raises:
        TrackerStateError: the state does not fit the tracker, the site or the radio model.
        KeyError: the area or the tracker is unknown.
        RadioModelError: the radio model cannot be used.
    """
    done, begun = -1, False
    answer = None if state is None else msgspec.json.decode(state, type=StateAnswer)
    if answer is not None:
        tracker, seed, done = answer.tracker, answer.seed, answer.chunk
    view = trained_view(site, area, radio_model)
    machine = make_tracker(tracker, view, seed)
    if answer is not None and done >= 0:
        check_radio(answer, view)
        machine.restore(msgspec.json.encode(answer.state))
    for mark, inputs in chunks:
        # Only the lead is older than the state; later, numbers may fall again: somebody set the clock back.
        if mark.area == area and (begun or mark.chunk > done):
            begun = True
            frame = machine.step(chunk_of(mark, inputs))
            yield frame, machine.revision()
