"""What a process keeps of people, and for how long, by its own settings: the answer to the query ``Keys.kept``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import msgspec
import structlog

__all__ = ["Kept", "decode_kept", "encode_kept", "rows_of", "state_on_disk"]


log = structlog.get_logger(__name__)


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


def rows_of(answers: Iterable[tuple[str, bytes]]) -> tuple[list[tuple[str, Kept]], set[str]]:
    """Return what services keep, by service, and which were heard; what two processes of one kind tell stands once.

    Args:
        answers: keys and payloads; what is not understood is left out, and logged.
    """
    rows: dict[tuple[str, Kept], None] = {}
    heard: set[str] = set()
    for key, payload in answers:
        service = key.split("/")[-2]
        try:
            rows |= dict.fromkeys((service, kept) for kept in decode_kept(payload))
        except msgspec.MsgspecError as error:
            log.warning("what is kept was not understood", service=service, error=str(error))
            continue
        heard.add(service)
    return sorted(rows, key=lambda row: row[0]), heard
