"""How well are people followed by each camera, over time? Nats per second of the tracks it feeds."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from shared.messages import TrackFrame

__all__ = ["CameraScores"]

PERIOD = 300.0
"""Seconds that make one score."""
KEPT = 288
"""Scores kept of each camera: a day."""
LEAST = 60.0
"""Seconds of tracks without which a period has no score."""
GAP = 2.0
"""Seconds between two frames beyond which nothing is known of the time between."""


@dataclass
class _Camera:
    nats: float = 0.0
    seconds: float = 0.0
    told: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=KEPT))


class CameraScores:
    """Keeps the scores of one area's cameras; feed it every track frame with its tracks' sight scores.

    A track counts for the cameras that fed it last: also while they miss it.

    Args:
        cameras: their ids.
    """

    def __init__(self, cameras: Sequence[str]) -> None:
        self._cameras = {camera: _Camera() for camera in cameras}
        self._fed: dict[int, tuple[str, ...]] = {}
        self._last: float | None = None
        self._begun = 0.0

    def take(self, frame: TrackFrame, sight: Mapping[int, float]) -> None:
        """Take in a frame; ``sight``: nats by which cameras spoke for each track since the frame before."""
        fed: dict[int, tuple[str, ...]] = {}
        for track, sources in zip(frame.track, frame.sources, strict=True):
            now = tuple(source for source in sources if source in self._cameras)
            if now or track in self._fed:
                fed[track] = now or self._fed[track]
        self._fed = fed
        last, self._last = self._last, frame.t
        if last is None or not 0.0 < frame.t - last < GAP:
            self._begin(frame.t)
            return
        for track, names in fed.items():
            for name in names if track in sight else ():
                self._cameras[name].nats += sight[track]
                self._cameras[name].seconds += frame.t - last
        if frame.t - self._begun >= PERIOD:
            for camera in self._cameras.values():
                if camera.seconds >= LEAST:
                    camera.told.append((frame.t, camera.nats / camera.seconds))
            self._begin(frame.t)

    def of(self, camera: str) -> tuple[list[float], list[float]]:
        """Return when (seconds since the epoch) and how well, nats per second of track, oldest first.

        Raises:
            KeyError: there is no such camera.
        """
        told = self._cameras[camera].told
        return [t for t, _ in told], [score for _, score in told]

    def _begin(self, t: float) -> None:
        self._begun = t
        for camera in self._cameras.values():
            camera.nats = camera.seconds = 0.0
