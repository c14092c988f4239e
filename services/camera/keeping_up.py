"""Does the detector keep up with the camera? Pure: time comes in as an argument."""

from __future__ import annotations

from collections import deque

__all__ = ["KeepingUp"]

WINDOW = 30.0
"""Seconds over which pictures are counted; a verdict needs ``LEAST`` of them."""
LEAST = 20.0
LEFT_OUT = 0.25
"""Share of the pictures that came and were left out for newer ones, above which …"""
NEEDED = 5.0
"""… fewer pictures a second than these are too few: in a fifth of a second people walk 0.3 m, further than that two who
pass each other are mixed up."""
EASE = 1.2
"""A camera that could not keep up is well again at so many times the rate needed."""
_TOLD = (1, 2, 5)
"""Rates that are told: words that change with every look are read by nobody."""


class KeepingUp:
    """Watches the pictures of one camera, those worked on and those left out."""

    def __init__(self) -> None:
        self._recent: deque[tuple[float, int]] = deque()
        self.doubt = ""
        """In plain words, while it cannot keep up; else empty."""

    def reset(self) -> None:
        """Begin anew: the source was opened again, and nothing came in between."""
        self._recent.clear()
        self.doubt = ""

    def take(self, now: float, left_out: int) -> None:
        """Note one picture that was worked on.

        Args:
            now: monotonic, s.
            left_out: pictures left out since the process began.
        """
        recent = self._recent
        recent.append((now, left_out))
        while now - recent[0][0] > WINDOW:
            recent.popleft()
        span = now - recent[0][0]
        if span < LEAST:
            return
        worked, lost = len(recent) - 1, left_out - recent[0][1]
        rate = worked / span
        needed = NEEDED * EASE if self.doubt else NEEDED
        if rate >= needed or lost <= LEFT_OUT * (worked + lost):
            self.doubt = ""
            return
        fewer = next((one for one in _TOLD if rate < one), _TOLD[-1])
        self.doubt = (
            f"cannot keep up: fewer than {fewer} pictures a second are worked on and the others left out, people are "
            f"missed and mixed up; {NEEDED:g} are needed: give this machine fewer cameras or more processor, or let "
            "the camera send smaller pictures"
        )
