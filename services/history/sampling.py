"""What of the stream of frames is kept: one frame of each area every so many seconds. No clock, no bus."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from services.history.entries import Counted, Entry, Points, Replaced
from shared.history_query import STATES
from shared.keys import is_identifier
from shared.messages import Covariance, Revision, TrackFrame

__all__ = ["LATEST", "Sampler", "plausible"]

LATEST = 221_845_392_000.0
"""The year 9000: a time beyond it is none."""
FARTHEST = 1e6
"""Metres from the plan's zero."""
UNSEEN = STATES.index("unseen")


def plausible(t: float) -> bool:
    """Whether ``t`` can be when something was measured."""
    return 0.0 <= t < LATEST


class Sampler:
    """Turns messages into entries.

    Args:
        interval: seconds between two frames of an area that are kept.
        floors: the floor of each area; of others nothing is kept.
    """

    def __init__(self, interval: float, floors: Mapping[str, str]) -> None:
        self._interval = interval
        self._floors = floors
        self._last: dict[str, int] = {}

    def tracks(self, frame: TrackFrame) -> list[Entry]:
        """Return what is kept of a frame: whom cameras saw, the devices, and how many there were."""
        if frame.area not in self._floors or not plausible(frame.t):
            return []
        bucket = math.floor(frame.t / self._interval)
        if self._last.get(frame.area) == bucket:
            return []
        self._last[frame.area] = bucket
        state = [STATES.index(name) for name in frame.state]
        rows = [
            row
            for row in range(len(frame.track))
            if _near(frame.x[row], frame.y[row]) and is_identifier(frame.floor[row])
        ]
        seen = [row for row in rows if state[row] != UNSEEN]
        named = {name: row for row in rows if (name := frame.device[row]) is not None and is_identifier(name)}
        entries: list[Entry] = [
            Counted(
                kind="area",
                t=frame.t,
                place=[frame.area],
                people=[sum(value != UNSEEN for value in state)],
                phones=[len({name for name in frame.device if name is not None})],
            )
        ]
        if seen:
            # Not by ``former``: a name that moves on leaves a track behind that may well be somebody else's.
            entries.append(self._points("track", frame, [str(frame.track[row]) for row in seen], seen, state))
        if named:
            entries.append(self._points("device", frame, list(named), list(named.values()), state))
        return entries

    def revision(self, told: Revision) -> Replaced | None:
        """Return what a revision says anew of devices, at the pace of what is kept; None where that is nothing."""
        floor = self._floors.get(told.area)
        devices = [
            place
            for place, (name, since) in enumerate(zip(told.device, told.since, strict=True))
            if is_identifier(name) and plausible(since)
        ]
        if floor is None or not devices or not plausible(told.t):
            return None
        known = set(devices)
        rows: dict[tuple[int, int], int] = {}
        for row, (of, t, x, y) in enumerate(zip(told.of, told.at, told.x, told.y, strict=True)):
            if of in known and plausible(t) and _near(x, y):
                rows.setdefault((of, math.floor(t / self._interval)), row)
        kept = list(rows.values())
        points = Points(
            kind="device",
            area=told.area,
            step=self._interval,
            subject=[told.device[told.of[row]] for row in kept],
            floor=[floor] * len(kept),
            t=[told.at[row] for row in kept],
            x=[told.x[row] for row in kept],
            y=[told.y[row] for row in kept],
            accuracy=[_sigma(told.covariance[row]) for row in kept],
            probability=[told.probability[row] for row in kept],
            track=[_id(told.track[row]) for row in kept],
            state=[0 if told.track[row] else UNSEEN for row in kept],
        )
        return Replaced(
            area=told.area,
            device=[told.device[place] for place in devices],
            since=[told.since[place] for place in devices],
            until=told.t,
            points=points,
        )

    def _points(
        self, kind: str, frame: TrackFrame, subject: list[str], rows: Sequence[int], state: Sequence[int]
    ) -> Points:
        return Points(
            kind="track" if kind == "track" else "device",
            area=frame.area,
            step=self._interval,
            subject=subject,
            floor=[frame.floor[row] for row in rows],
            t=[frame.t] * len(rows),
            x=[frame.x[row] for row in rows],
            y=[frame.y[row] for row in rows],
            accuracy=[_sigma(frame.covariance[row]) for row in rows],
            probability=[frame.probability[row] for row in rows],
            track=[_id(frame.track[row]) for row in rows],
            state=[state[row] for row in rows],
        )


def _near(x: float, y: float) -> bool:
    return abs(x) < FARTHEST and abs(y) < FARTHEST


def _id(track: int) -> int:
    return track if 0 <= track < 2**31 else 0


def _sigma(covariance: Covariance) -> float:
    """One sigma of a circle as large as the ellipse's mean square, m."""
    return min(math.sqrt(max(0.5 * (covariance[0] + covariance[2]), 0.0)), FARTHEST)
