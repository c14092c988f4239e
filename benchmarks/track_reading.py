"""What do published tracks say of each carrier at each time of the truth? By the names they bear, or by the best match.

Both answers have the form that ``benchmarks.position_error`` scores: (n, k, 2), at the n times of a truth, for its k
carriers in the order of ``Truth.carriers()``; NaN where the tracks say nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from benchmarks.world_record import Truth
from shared.messages import TrackFrame

__all__ = ["FRESH", "matched_positions", "named_positions", "newest_frames", "windows_of"]

Array = NDArray[np.float64]

FRESH = 2.0
"""Seconds; what was said longer ago says nothing of now."""
SAME = 1e-6
"""Seconds within which two times since the epoch are one."""


def windows_of(t: Array, window: float) -> NDArray[np.int64]:
    """Return the number of the window, from 0, that each of (n,) increasing times lies in; the first time begins one.

    ValueError: the window is not longer than 0 s.
    """
    if not window > 0.0:
        raise ValueError(f"window: {window} s; allowed: more than 0")
    return np.floor((t - t[:1] + SAME) / window).astype(np.int64)


def newest_frames(t: Array, frames: Sequence[TrackFrame], fresh: float = FRESH) -> NDArray[np.int64]:
    """Return the place of the newest frame at or before each of (n,) times; -1 where it is older than ``fresh`` s."""
    told = np.array([frame.t for frame in frames])
    newest = np.searchsorted(told, t + SAME, side="right") - 1
    age = t - told[newest] if len(told) else np.zeros(len(t))
    return np.where((newest >= 0) & (age <= fresh + SAME), newest, -1)


def named_positions(truth: Truth, frames: Sequence[TrackFrame], fresh: float = FRESH) -> Array:
    """Return where each carrier's device is according to the track that bears its name.

    The newest frame at or before a time speaks for it; if no track of that frame bears the name, nothing is known, even
    if an older one did. Of several tracks with one name the most probable counts.

    Args:
        truth: gives times and carriers.
        frames: in the order of their times.
        fresh: a frame older than this, in seconds, says nothing.
    """
    devices = [truth.device[place] for place in truth.carriers()]
    said = np.full((len(frames) + 1, len(devices), 2), np.nan)  # the last row, which -1 picks, says nothing
    column = {device: number for number, device in enumerate(devices)}
    for row, frame in enumerate(frames):
        surest: dict[int, float] = {}
        for device, probability, x, y in zip(frame.device, frame.probability, frame.x, frame.y, strict=True):
            number = column.get(device)
            if number is not None and probability > surest.get(number, -1.0):
                surest[number] = probability
                said[row, number] = x, y
    return said[newest_frames(truth.t, frames, fresh)]


def matched_positions(truth: Truth, frames: Sequence[TrackFrame], window: float = 60.0) -> Array:
    """Return where each carrier is according to the anonymous track that suits it best, window by window.

    How the studies scored anonymous tracks per person is unpublished; [ravel-thesis §10, vision-only RBMCDA] suggests a
    Hungarian matching per window, and this is the rule here: in each window every person about gets at most one track
    and every track at most one person, such that the squared errors over the times the people are in view are least in
    sum (people without a device take part, so that nobody's track is given away). At times at which the matched track
    does not exist its position nearest in time, within the window, is held. There is no gate: a bad match is a large
    error. People left over when tracks are fewer get nothing.

    Args:
        truth: gives times, people and windows, which count from its first time.
        frames: in any order.
        window: seconds.
    """
    carriers = truth.carriers()
    found = np.full((len(truth.t), len(truth.person), 2), np.nan)
    counts = [len(frame.track) for frame in frames]
    t = np.repeat([frame.t for frame in frames], counts)
    track = np.array([number for frame in frames for number in frame.track], np.int64)
    place = np.array([at for frame in frames for at in zip(frame.x, frame.y, strict=True)], np.float64).reshape(-1, 2)
    order = np.lexsort((t, track))
    t, track, place = t[order], track[order], place[order]
    scored = truth.in_view & np.isfinite(truth.position).all(axis=2)
    number = windows_of(truth.t, window)
    for this in np.unique(number):
        times = np.flatnonzero(number == this)
        begin = truth.t[0] + this * window
        told = np.flatnonzero((t >= begin - SAME) & (t < begin + window - SAME))
        people = np.flatnonzero(scored[times].any(axis=0))
        if not len(told) or not len(people):
            continue
        held = _nearest_in_time(truth.t[times], t[told], track[told], place[told])
        cost = np.empty((len(people), held.shape[1]))
        for row, person in enumerate(people):
            mine = scored[times, person]
            apart = held[mine] - truth.position[times[mine], person][:, None]
            cost[row] = (apart**2).sum(axis=(0, 2))
        rows, columns = linear_sum_assignment(cost)
        found[times[:, None], people[rows]] = held[:, columns]
    return found[:, carriers]


def _nearest_in_time(times: Array, t: Array, track: NDArray[np.int64], place: Array) -> Array:
    """Return (n, m, 2): of each of m tracks, in the order of their ids, the position nearest in time to n times.

    ``t``, ``track`` and ``place`` are rows sorted by track, then time.
    """
    begins = np.flatnonzero(np.diff(track, prepend=track[0] - 1))
    held = np.empty((len(times), len(begins), 2))
    for column, (begin, end) in enumerate(zip(begins, [*begins[1:], len(track)], strict=True)):
        after = np.clip(np.searchsorted(t[begin:end], times), 1, max(end - begin - 1, 1))
        before = begin + after - 1
        after = np.minimum(begin + after, end - 1)
        nearer = np.where(np.abs(times - t[before]) <= np.abs(t[after] - times), before, after)
        held[:, column] = place[nearer]
    return held
