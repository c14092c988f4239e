"""What fed each person's track lately, and since when is a phone theirs? What single frames do not tell."""

from __future__ import annotations

import msgspec

from shared.messages import TrackFrame

__all__ = ["Since", "TrackMemory"]

SOURCES_KEPT = 1.0
"""Seconds: a phone tells of its steps once a second, a camera may send few pictures."""

Since = dict[tuple[int, str], float]
"""When each person's device became theirs, seconds since the epoch, by track and device."""


class TrackMemory:
    """What was told of the people of one area; holds no more than its newest frame and a second of sources."""

    def __init__(self) -> None:
        self._since: Since = {}
        self._sources: dict[int, dict[str, float]] = {}

    def take(self, frame: TrackFrame) -> tuple[TrackFrame, Since]:
        """Return the frame with all that fed each track in the last second, and since when names are held.

        A name goes on without a break where the track goes on under another number (``former``).
        """
        since: Since = {}
        sources: dict[int, dict[str, float]] = {}
        now = frame.t
        for track, device, former, fed in zip(frame.track, frame.device, frame.former, frame.sources, strict=True):
            lately = sources[track] = self._sources.get(track, {})
            for name in fed:
                lately[name] = now
            for name in [name for name, t in lately.items() if not 0.0 <= now - t <= SOURCES_KEPT]:
                del lately[name]
            if device is not None:
                held = self._since.get((track, device))
                for before in former if held is None else ():
                    held = self._since.get((before, device), held)
                since[track, device] = now if held is None else min(held, now)
        self._since, self._sources = since, sources
        return msgspec.structs.replace(frame, sources=[sorted(sources[track]) for track in frame.track]), since

    def erase(self, device: str) -> None:
        """Forget a device whose consent was withdrawn."""
        self._since = {key: t for key, t in self._since.items() if key[1] != device}
        for fed in self._sources.values():
            fed.pop(device, None)
