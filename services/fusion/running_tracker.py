"""The tracker as it runs: chunk after chunk, under the radio that is active; its state at a boundary for who asks."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import msgspec

from services.fusion.active_radio import ActiveRadio
from services.fusion.area_view import AreaView
from services.fusion.radio_file import RadioFile
from services.fusion.registry import make_tracker
from services.fusion.replay import StateAnswer, radio_of_state
from services.fusion.tracker import Chunk, TrackerStateError
from shared.messages import RadioModelUpdate, TrackFrame

__all__ = ["RunningTracker"]


class RunningTracker:
    """One area's tracker.

    Args:
        view: the area under the radio model it starts with.
        name: of the tracker.
        seed: of it.

    Attributes:
        tracker: the machine itself.
        radio: what it runs under.
        chunk: number of the last chunk it consumed; -1 before the first.
    """

    def __init__(self, view: AreaView, name: str, seed: int) -> None:
        self._name, self._seed = name, seed
        self.radio = ActiveRadio(view)
        self.tracker = make_tracker(name, view, seed)
        self.chunk = -1
        self._boundary = threading.Lock()
        """Held while a chunk is consumed, so that a state is always one of a chunk boundary."""

    def step(self, chunk: Chunk) -> TrackFrame:
        """Consume a chunk."""
        with self._boundary:
            frame = self.radio.step(self.tracker, chunk)
            self.chunk = chunk.index
        return frame

    def answer(self) -> bytes:
        """Return the state at the last chunk boundary as a ``StateAnswer`` in JSON, with its radio model."""
        taken = self._snapshot()
        return self._encoded(taken, taken.model)

    def to_save(self, beside: RadioFile) -> tuple[int, Callable[[], bytes]]:
        """Copy the tracker; return the chunk it is of and what encodes the copy, in any thread.

        To encode takes longer than the time between two chunks may be: fusion goes on meanwhile. The radio model is
        not in it: it is kept ``beside``.
        """
        taken = self._snapshot()

        def saved() -> bytes:
            beside.write(taken.radio, taken.model)
            return self._encoded(taken, None)

        return taken.chunk, saved

    def restore(self, saved: bytes, beside: RadioFile) -> None:
        """Go on from a saved state, under the radio it was made with.

        Raises:
            msgspec.DecodeError: the bytes are no state.
            TrackerStateError: the state is of another tracker or another radio; nothing has changed then.
        """
        state = msgspec.json.decode(saved, type=StateAnswer)
        if state.tracker != self._name:
            raise TrackerStateError(f"a state of tracker {state.tracker!r}, expected {self._name!r}")
        radio = radio_of_state(state, self.radio, beside.read(state.radio))
        tracker = make_tracker(self._name, radio.view, self._seed)
        tracker.restore(msgspec.json.encode(state.state))
        self.radio, self.tracker, self.chunk = radio, tracker, state.chunk

    def _snapshot(self) -> _Snapshot:
        with self._boundary:
            return _Snapshot(self.chunk, self.tracker.snapshot(), self.radio.digest, self.radio.update)

    def _encoded(self, taken: _Snapshot, model: RadioModelUpdate | None) -> bytes:
        return msgspec.json.encode(
            StateAnswer(
                chunk=taken.chunk,
                tracker=self._name,
                seed=self._seed,
                radio=taken.radio,
                model=model,
                state=msgspec.Raw(taken.encode()),
            )
        )


@dataclass(frozen=True)
class _Snapshot:
    """The tracker after a chunk: what encodes it, the digest of its radio, and the model that went live, if one did."""

    chunk: int
    encode: Callable[[], bytes]
    radio: str
    model: RadioModelUpdate | None
