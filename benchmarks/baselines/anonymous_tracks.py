"""Where was somebody, when one cannot say who? The answer of trackers that only see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.messages import TrackFrame

__all__ = ["AnonymousTracks", "TrackRows"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class AnonymousTracks:
    """Tracks at n times, one row per track and time.

    Attributes:
        t: (n,) the times asked for, seconds.
        when: (r,) places in ``t``, not decreasing.
        track: (r,) ids, kept for as long as the tracker believes it to be the same person.
        position: (r, 2), metres.
    """

    t: Array
    when: NDArray[np.int64]
    track: NDArray[np.int64]
    position: Array

    def at(self, place: int) -> list[tuple[int, float, float]]:
        """Return (track id, x, y) of everybody at ``t[place]``."""
        first, last = np.searchsorted(self.when, [place, place + 1])
        rows = zip(self.track[first:last], self.position[first:last], strict=True)
        return [(int(track), float(x), float(y)) for track, (x, y) in rows]

    def frames(self, area: str, floor: str) -> list[TrackFrame]:
        """Return the tracks as fusion would publish them, one frame per time; covariance and velocity are not told."""
        edges = np.searchsorted(self.when, np.arange(len(self.t) + 1)).tolist()
        track, x, y = self.track.tolist(), self.position[:, 0].tolist(), self.position[:, 1].tolist()
        frames = []
        for place, (t, first, last) in enumerate(zip(self.t.tolist(), edges[:-1], edges[1:], strict=True)):
            n = last - first
            nothing, none = [0.0] * n, [None] * n
            frames.append(
                TrackFrame(
                    t=t,
                    area=area,
                    chunk=place,
                    tracker="baseline",
                    track=track[first:last],
                    floor=[floor] * n,
                    x=x[first:last],
                    y=y[first:last],
                    covariance=[(0.0, 0.0, 0.0)] * n,
                    vx=nothing,
                    vy=nothing,
                    state=["confirmed"] * n,
                    device=list(none),
                    probability=nothing,
                    runner_up=list(none),
                    runner_up_probability=nothing,
                    former=[[] for _ in range(n)],
                    sources=[[] for _ in range(n)],
                    quality=nothing,
                )
            )
        return frames

    def between(self, first: int, last: int) -> tuple[NDArray[np.int64], Array]:
        """Return the ids (m,) of the tracks at ``t[first:last]`` and their places (last - first, m, 2), else NaN."""
        begin, end = np.searchsorted(self.when, [first, last])
        ids, column = np.unique(self.track[begin:end], return_inverse=True)
        places = np.full((last - first, len(ids), 2), np.nan)
        places[self.when[begin:end] - first, column] = self.position[begin:end]
        return ids, places


class TrackRows:
    """Collects rows while a tracker runs.

    Args:
        t: (n,) the times asked for, increasing.
    """

    def __init__(self, t: Array) -> None:
        self.times: Array = np.asarray(t, float)
        if np.any(np.diff(self.times) < 0.0):
            raise ValueError("times: they must not decrease")
        self._next = 0
        self._when: list[NDArray[np.int64]] = []
        self._track: list[NDArray[np.int64]] = []
        self._position: list[Array] = []

    def due(self, until: float) -> range:
        """Return the places of the times before ``until`` that were not answered yet, and count them as answered."""
        first = self._next
        self._next = int(np.searchsorted(self.times, until, side="left"))
        return range(first, max(first, self._next))

    def add(self, place: int, track: NDArray[np.int64], position: Array) -> None:
        """Note where the tracks are at the time at ``place``."""
        self._when.append(np.full(len(track), place, np.int64))
        self._track.append(track)
        self._position.append(position)

    def tracks(self) -> AnonymousTracks:
        """Return all that was noted."""
        if not self._when:
            return AnonymousTracks(self.times, np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)))
        when, track = np.concatenate(self._when), np.concatenate(self._track)
        return AnonymousTracks(self.times, when, track, np.concatenate(self._position))
