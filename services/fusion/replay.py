"""What fusion made of a recording, computed anew: the same chunks in the same order give the same bytes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec

from services.fusion.active_radio import ActiveRadio
from services.fusion.registry import DEFAULT_TRACKER, make_tracker
from services.fusion.tracker import Chunk, TrackerStateError
from services.fusion.trained_view import trained_view
from shared.messages import (
    ChunkMark,
    DetectionFrame,
    Erasure,
    Message,
    MotionBatch,
    RadioModelUpdate,
    RadioScan,
    Revision,
    TrackFrame,
)
from shared.radio import RadioModelError
from shared.site import Site

__all__ = ["StateAnswer", "chunk_of", "radio_of_state", "replay_steps", "replay_tracks"]


class StateAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """What fusion answers when asked for its state: the tracker as it was after one chunk."""

    chunk: int
    """Number of that chunk; −1 before the first."""
    tracker: str
    seed: int = 0
    radio: str = ""
    """``radio_digest`` of the area's radio; empty where whoever answered did not tell."""
    model: RadioModelUpdate | None = None
    """What went live in mid-run and was active; None: the radio it started with, or a file beside this one says."""
    state: Any


def radio_of_state(answer: StateAnswer, started: ActiveRadio, model: RadioModelUpdate | None = None) -> ActiveRadio:
    """Return the radio a state was made with.

    Args:
        answer: the state.
        started: the radio that settings and site file say.
        model: the model kept beside the state; the state's own goes before it.

    Raises:
        TrackerStateError: it was another one, and nothing says which: what the tracker learned of its errors would
            count twice.
    """
    radio, update = started, answer.model or model
    if update is not None:
        radio = ActiveRadio(started.view)
        try:
            radio.resume(update)
        except RadioModelError as error:
            raise TrackerStateError(f"a state of a radio model that does not fit any more: {error}") from error
    if answer.radio and answer.radio != radio.digest:
        raise TrackerStateError(
            "a state of another radio model: the site file's access points or the trained model are others now"
        )
    return radio


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
        models=tuple(message for message in inputs if isinstance(message, RadioModelUpdate)),
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
        radio_model: the trained model fusion started with, if it had one; what went live since is in the chunks.

    Raises:
        TrackerStateError: the state does not fit the tracker, the site or the radio model.
        KeyError: the area or the tracker is unknown.
        RadioModelError: the radio model cannot be used.
    """
    done, begun = -1, False
    answer = None if state is None else msgspec.json.decode(state, type=StateAnswer)
    if answer is not None:
        tracker, seed, done = answer.tracker, answer.seed, answer.chunk
    radio = ActiveRadio(trained_view(site, area, radio_model))
    if answer is not None and done >= 0:
        radio = radio_of_state(answer, radio)
    machine = make_tracker(tracker, radio.view, seed)
    if answer is not None and done >= 0:
        machine.restore(msgspec.json.encode(answer.state))
    for mark, inputs in chunks:
        # Only the lead is older than the state; later, numbers may fall again: somebody set the clock back.
        if mark.area == area and (begun or mark.chunk > done):
            begun = True
            frame = radio.step(machine, chunk_of(mark, inputs))
            yield frame, machine.revision()
