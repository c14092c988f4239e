"""What an operator is told of an access point, in plain words."""

from __future__ import annotations

import time

__all__ = ["reading_words", "silent_words"]


def reading_words(name: str, by: float, since: float, *, whole: bool = False, moved: float | None = None) -> str:
    """Return what to say of an access point that reads ``by`` dB otherwise since then (seconds since the epoch).

    Args:
        name: its id.
        by: dB; where it ``moved``, metres from where it was believed to hang, it plays no part.
        since: see above.
        whole: whether it does so nearly everywhere.
        moved: see above.
    """
    clock = _clock(since)
    if moved is not None:
        return f"access point {name} seems to hang {moved:.0f} m from where the site file says, since {clock}: was it moved?"
    reads = f"access point {name} reads {abs(by):.0f} dB {'higher' if by > 0.0 else 'lower'} than it did"
    if whole:
        return f"{reads} since {clock}: was its power changed, or its antenna turned?"
    return f"{reads} in part of the area since {clock}: {'is a wall gone' if by > 0.0 else 'is there a new wall'}?"


def silent_words(name: str, since: float) -> str:
    """Return what to say of an access point nobody hears any more."""
    return f"access point {name} has not been heard since {_clock(since)} where it should be: does it have power?"


def _clock(t: float) -> str:
    return time.strftime("%H:%M", time.localtime(t))
