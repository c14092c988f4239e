"""From what fusion and phones publish to stretches: who was on which track, once nobody revises it any more.

Names are thought over for some seconds, steps are told late, and both may be told again. So nothing teaches before it
is ``settle`` seconds old. Then a device's time on one track is cut where the track changes, where it is lost for a
second, and at ``window`` seconds, so that sums over stretches compare [ravel-thesis §8.1]. What phones say is
kept for some minutes at most, also where fusion is silent.
"""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.learning.tracks.along import along
from services.learning.tracks.crowd import Crowd, followed_in, others_of
from services.learning.tracks.phones import PhoneRows, Phones
from services.learning.tracks.stretch import SAME, Stretch
from shared.messages import MotionBatch, RadioScan, Revision, TrackFrame

__all__ = ["StretchAssembler"]

Array = NDArray[np.float64]

PAUSE = 1.0
"""Seconds without the name after which a track that bears it again begins a new stretch."""
SHORTEST = 2.0
"""Seconds; what is shorter teaches nothing."""
LATE = 240.0
"""Seconds by which ``close`` may be called late and nothing said is lost."""

Point = tuple[float, int, float, float, float, float, float, float]
"""t, track, x, y, xx, xy, yy, probability."""


@dataclass(frozen=True)
class _Seen(Crowd):
    """Also (n,) who was seen, and what cameras said since the last."""

    seen: NDArray[np.bool_]
    sight: Array


class StretchAssembler:
    """Collects one area's messages in the order in which they come.

    Args:
        points: ids of the area's access points; others are left out.
        window: seconds, the longest stretch.
        settle: seconds after which nothing is revised any more.
        every: seconds between two kept rows of a track.
    """

    def __init__(self, points: Sequence[str], window: float = 60.0, settle: float = 12.0, every: float = 0.2) -> None:
        self._window, self._settle, self._every = window, settle, every
        self._phones = Phones(points, window + settle + LATE)
        self._points: dict[str, list[Point]] = {}
        self._crowd: deque[_Seen] = deque()
        self._pending: dict[int, float] = {}
        self._last = -math.inf

    def take_frame(self, frame: TrackFrame, sight: Mapping[int, float] | None = None) -> None:
        """Take in a frame; ``sight``: nats by which cameras spoke for each track in it (``quality.SightScore``)."""
        if frame.t < self._last - self._settle:
            self._reset()  # a clock set back
        for track, gain in (sight or {}).items():
            self._pending[track] = self._pending.get(track, 0.0) + gain
        if frame.t < self._last + self._every - SAME:
            return
        self._last = frame.t
        self._phones.take_time(frame.t)
        followed, ids, places = followed_in(frame)
        seen = np.array([frame.state[row] == "confirmed" for row in followed], np.bool_)
        spoken = np.array([self._pending.get(track, 0.0) for track in ids.tolist()])
        self._crowd.append(_Seen(frame.t, ids, places, seen, spoken))
        self._pending.clear()
        for row in followed:
            device = frame.device[row]
            if device is not None:
                place = (frame.t, frame.track[row], frame.x[row], frame.y[row])
                insort(self._points.setdefault(device, []), (*place, *frame.covariance[row], frame.probability[row]))

    def take_revision(self, revision: Revision) -> None:
        """Replace what was said of some devices' last seconds."""
        rows: dict[int, list[Point]] = {number: [] for number in range(len(revision.device))}
        last = dict.fromkeys(rows, -math.inf)
        for index, (number, t) in enumerate(zip(revision.of, revision.at, strict=True)):
            if t < last[number] + self._every - SAME:
                continue
            last[number] = t
            if revision.track[index] > 0:
                place = (t, revision.track[index], revision.x[index], revision.y[index])
                rows[number].append((*place, *revision.covariance[index], revision.probability[index]))
        for number, (device, since) in enumerate(zip(revision.device, revision.since, strict=True)):
            points = self._points.setdefault(device, [])
            first = bisect_left(points, (since - SAME,))
            after = bisect_left(points, (revision.t + SAME,))
            points[first:after] = rows[number]

    def take_scan(self, scan: RadioScan) -> None:
        """Take in what a phone heard."""
        self._phones.take_scan(scan)

    def take_motion(self, batch: MotionBatch) -> None:
        """Take in how a phone walked; a batch may replace what was told before."""
        self._phones.take_motion(batch)

    def forget(self, device: str) -> None:
        """Forget a device whose owner withdrew consent."""
        self._phones.pop(device, None)
        self._points.pop(device, None)

    def close(self, now: float | None = None) -> list[Stretch]:
        """Return the stretches that ended, in order of device and time; each is returned once.

        Args:
            now: seconds since the epoch; None: the time of the newest frame. What is ``settle`` older is closed.
        """
        until = (self._last if now is None else now) - self._settle
        closed: list[Stretch] = []
        for device in sorted(self._phones.keys() | self._points.keys()):
            closed += self._close(device, until)
        oldest = min((points[0][0] for points in self._points.values()), default=math.inf)
        while self._crowd and self._crowd[0].t < min(oldest, until) - SAME:
            self._crowd.popleft()
        return closed

    def _reset(self) -> None:
        self._phones.clear()
        self._points.clear()
        self._crowd.clear()
        self._pending.clear()
        self._last = -math.inf

    def _close(self, device: str, until: float) -> list[Stretch]:
        phone, points = self._phones.get(device, PhoneRows()), self._points.get(device, [])
        closed: list[Stretch] = []
        kept_from = until
        begin = 0
        for end in range(1, len(points) + 1):
            first, before = points[begin], points[end - 1]
            if before[0] > until:
                break
            cut = end == len(points) or points[end][1] != first[1] or points[end][0] - before[0] > PAUSE
            if end == len(points) and until - before[0] <= PAUSE:
                break  # it may go on
            if cut or points[end][0] - first[0] > self._window + SAME:
                if before[0] - first[0] >= SHORTEST:
                    closed.append(self._stretch(device, phone, points[begin:end]))
                begin = end
        if begin < len(points):
            kept_from = min(kept_from, points[begin][0])
        phone.forget_before(kept_from - SAME)
        del points[: bisect_left(points, (kept_from - SAME,))]
        if not points:
            self._points.pop(device, None)
        if not (points or phone.readings or phone.steps or phone.still):
            self._phones.pop(device, None)
        return closed

    def _stretch(self, device: str, phone: PhoneRows, points: list[Point]) -> Stretch:
        table = np.array(points, float)
        t, track = table[:, 0], int(table[0, 1])
        place = table[:, 2:4]
        covariance = table[:, [4, 5, 5, 6]].reshape(-1, 2, 2)
        seen, sight = self._sight(track, t)
        return along(
            device,
            phone,
            track,
            t,
            place,
            covariance,
            table[:, 7],
            seen=seen,
            sight=sight,
            others=others_of(self._crowd, track, t, place),
        )

    def _sight(self, track: int, t: Array) -> tuple[NDArray[np.bool_], Array]:
        """Return whether cameras saw the track at (n,) times, and the nats they spoke for it since the time before."""
        seen, sight = np.zeros(len(t), np.bool_), np.zeros(len(t))
        for crowd in self._crowd:
            if not t[0] - SAME <= crowd.t <= t[-1] + SAME:
                continue
            row = crowd.row_of(track)
            if row is not None:
                at = int(np.searchsorted(t, crowd.t - SAME))
                seen[at] = seen[at] or crowd.seen[row]
                sight[at] += crowd.sight[row]
        return seen, sight
