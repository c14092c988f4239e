"""The learned radio model beside a saved state: written once when it goes live, found by the digest the state names.

A state is saved every few seconds and a model may weigh megabytes. The file that the state before names stays until the
next state is on the disk, so that a kill at any moment leaves a state and the model it was made with.
"""

from __future__ import annotations

import re
from pathlib import Path

from shared.messages import MessageError, RadioModelUpdate, decode, encode
from shared.state_file import write_whole

__all__ = ["RadioFile"]

NAMED = 16
"""Digits of the digest that stand in a file's name."""


class RadioFile:
    """The models beside one state file.

    Args:
        state: where the state lies; None keeps nothing.
    """

    def __init__(self, state: Path | None) -> None:
        self._state = state
        self._written: RadioModelUpdate | None = None
        self._named = ""
        """The file that the state before names."""

    def write(self, digest: str, update: RadioModelUpdate | None) -> None:
        """Keep the model that is active while a state is saved, and drop those that no state names any more.

        Raises:
            OSError: it cannot be written.
        """
        if self._state is None:
            return
        file = _beside(self._state, digest)
        if update is not None and update is not self._written:
            write_whole(file, encode(update))
            self._written = update
        for other in self._state.parent.glob(f"{self._state.stem}.*.radio"):
            named = re.fullmatch(rf"{re.escape(self._state.stem)}\.[0-9a-f]{{{NAMED}}}\.radio", other.name)
            if named and other.name not in (file.name, self._named):
                other.unlink(missing_ok=True)
        self._named = file.name

    def read(self, digest: str) -> RadioModelUpdate | None:
        """Return the model a state names; None where none is kept, or what is kept is damaged."""
        if self._state is None or not digest:
            return None
        file = _beside(self._state, digest)
        try:
            update = decode(file.read_bytes(), RadioModelUpdate)
        except (OSError, MessageError):
            return None
        self._written, self._named = update, file.name
        return update


def _beside(state: Path, digest: str) -> Path:
    return state.with_name(f"{state.stem}.{digest[:NAMED]}.radio")
