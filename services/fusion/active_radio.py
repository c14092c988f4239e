"""Under which radio model does an area's tracker run, which may follow it, and how is one swapped for the next?

A swap is part of what a chunk consumed: it happens before the chunk is stepped, live and in a replay alike.
"""

from __future__ import annotations

import msgspec

from services.fusion.area_view import AreaView
from services.fusion.tracker import Chunk, Retuning, Tracker
from services.fusion.trained_view import radio_digest, under_model
from shared.messages import RadioModelUpdate, TrackFrame
from shared.radio import RadioModelError

__all__ = ["ActiveRadio"]


class ActiveRadio:
    """One area's radio.

    Args:
        view: the area under the model it starts with.

    Attributes:
        view: the area under the active model.
        update: what made it active; None: it is the one it started with.
        digest: ``radio_digest`` of the active model.
    """

    def __init__(self, view: AreaView) -> None:
        self.view = view
        self.update: RadioModelUpdate | None = None
        self.digest = radio_digest(view)
        self._newest: int | None = None
        """Version of the newest model accepted, active or waiting for its chunk; None: nobody knows."""
        self._prepared: tuple[RadioModelUpdate, AreaView] | None = None

    def accept(self, update: RadioModelUpdate) -> bool:
        """Whether a model is to go live with the next chunk; False: it is the active one, or older.

        Raises:
            RadioModelError: it cannot be used here; the text says why.
        """
        if update.area != self.view.area:
            raise RadioModelError(f"of area {update.area!r}, expected {self.view.area!r}")
        if self._newest is not None and update.version <= self._newest:
            return False
        self._prepared = update, under_model(self.view, update.model)
        self._newest = update.version
        return True

    def older(self, update: RadioModelUpdate) -> bool:
        """Whether a model is older than one that was accepted."""
        return self._newest is not None and update.version < self._newest

    def resume(self, update: RadioModelUpdate) -> None:
        """Take a model for active that was when a state was saved.

        Raises:
            RadioModelError: it cannot be used here.
        """
        self._activate(update, under_model(self.view, update.model))

    def step(self, tracker: Tracker, chunk: Chunk) -> TrackFrame:
        """Swap the tracker's radio where the chunk says so, and let it consume the chunk.

        Raises:
            RadioModelError: a recorded model cannot be used here; one that was accepted can.
        """
        if isinstance(tracker, Retuning):
            for update in chunk.models:
                view = self._view_under(update)
                tracker.retune(view)
                self._activate(update, view)
        fed = sorted({frame.camera for frame in chunk.frames})
        return msgspec.structs.replace(tracker.step(chunk), cameras=fed)

    def _view_under(self, update: RadioModelUpdate) -> AreaView:
        prepared, self._prepared = self._prepared, None
        if prepared is not None and prepared[0] is update:
            return prepared[1]
        return under_model(self.view, update.model)

    def _activate(self, update: RadioModelUpdate, view: AreaView) -> None:
        self.view, self.update, self.digest = view, update, radio_digest(view)
        self._newest = update.version
