"""What a process keeps of people, and for how long, by its own settings: the answer to the query ``Keys.kept``."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

__all__ = ["Kept", "decode_kept", "encode_kept", "state_on_disk"]


class Kept(msgspec.Struct, frozen=True, kw_only=True):
    """One kind of thing that is kept."""

    what: str
    """In plain words, for a visitor."""
    settings: tuple[str, ...] = ()
    """Names of the settings that decide it; none: it is always so."""
    seconds: float | None = None
    """For how long; None: until what ``note`` says."""
    note: str = ""


def state_on_disk(what: str, every: float) -> Kept:
    """Return the row of a state file (settings ``state_folder``, ``state_every``) that is written ``every`` s."""
    named = ("state_folder", "state_every")
    return Kept(what=what, settings=named, seconds=every, note="then the next takes its place")


_decoder = msgspec.json.Decoder(list[Kept])


def encode_kept(rows: Sequence[Kept]) -> bytes:
    """Return an answer as it travels, JSON."""
    return msgspec.json.encode(rows)


def decode_kept(payload: bytes) -> list[Kept]:
    """Return an answer.

    Raises:
        msgspec.MsgspecError: it is none.
    """
    return _decoder.decode(payload)
