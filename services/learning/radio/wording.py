"""What an operator is told of an access point, in plain words; times are seconds since the epoch."""

from __future__ import annotations

import time

__all__ = [
    "UNTIL",
    "believed_words",
    "doubted_words",
    "moved_words",
    "placed_words",
    "reading_words",
    "silent_words",
    "unplaced_words",
]


UNTIL = "not gone by until it is learned anew"


def doubted_words(*names: str) -> str:
    """Return what to say of access points that do not read what the live model foretells."""
    what = UNTIL if len(names) == 1 else UNTIL.replace("it is", "they are")
    return f"{', '.join(names)} no longer read{'s' * (len(names) == 1)} what was learned: {what}"


def believed_words(*names: str) -> str:
    """Return what to say of access points that were doubted and do."""
    return f"{', '.join(names)} read{'s' * (len(names) == 1)} what was learned, after all"


def reading_words(name: str, by: float, since: float, *, whole: bool) -> str:
    """Return what to say of an access point that reads ``by`` dB otherwise since then, nearly everywhere or in part."""
    reads = f"access point {name} reads {abs(by):.0f} dB {'higher' if by > 0.0 else 'lower'} than it did"
    if whole:
        return f"{reads} since {_clock(since)}: was its power changed, or its antenna turned?"
    what = "is a wall gone" if by > 0.0 else "is there a new wall"
    return f"{reads} in part of the area since {_clock(since)}: {what}?"


def moved_words(name: str, away: float, since: float) -> str:
    """Return what to say of an access point that hangs ``away`` metres from where it was believed to."""
    return f"access point {name} seems to hang {away:.0f} m from where it did, since {_clock(since)}: was it moved?"


def unplaced_words(name: str, readings: int, needed: int, unclear: float | None) -> str:
    """Return what to say of an access point of which nobody knows where it hangs.

    Args:
        name: its id.
        readings: heard of it so far.
        needed: how many it takes.
        unclear: metres to which its place is known by now, where that is too little.
    """
    if readings < needed:
        return f"access point {name} is not placed yet: {readings} readings of {needed} needed"
    sure = "" if unclear is None else f", known only to within {unclear:.1f} m"
    return f"access point {name} is not placed yet{sure}: {readings} readings, more are needed from elsewhere"


def placed_words(name: str, *, live: bool) -> str:
    """Return what to say of an access point the site file does not place, once it is found."""
    waiting = "" if live else "; not used until a radio model with it has won its trial"
    return f"access point {name} was found by what phones hear of it{waiting}"


def silent_words(name: str, since: float) -> str:
    """Return what to say of an access point nobody hears any more."""
    return f"access point {name} has not been heard since {_clock(since)} where it should be: does it have power?"


def _clock(t: float) -> str:
    return time.strftime("%H:%M", time.localtime(t))
