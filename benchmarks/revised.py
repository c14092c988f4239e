"""What did fusion say of each device at each time, and what did it say of the same times a few seconds later?

A ``Said`` is what there is to score: where, on which track, seen by a camera or not. ``said_live`` reads it off the
published frames; ``said_later`` takes the revisions in that came soon enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from benchmarks.track_reading import FRESH, newest_frames
from shared.messages import Revision, TrackFrame

__all__ = ["UNSEEN", "Said", "said_later", "said_live"]

Array = NDArray[np.float64]

UNSEEN = 0
"""In place of a track's id: no camera saw the device, its place comes from steps and radio."""
NOTHING = -1
HELD = 0.5
"""Seconds for which a point of a revision speaks, where no other follows sooner."""
SAME = 1e-6


@dataclass(frozen=True)
class Said:
    """What was said of k devices at n times.

    Attributes:
        position: (n, k, 2) metres; NaN where nothing was said.
        track: (n, k), the track that carried the device; ``UNSEEN``; ``NOTHING`` where nothing was said.
        sigma: (n, k) metres, standard deviation along the covariance's longer axis; NaN where nothing was said.
        probability: (n, k) of the name being right; 0 where nothing was said.
    """

    position: Array
    track: NDArray[np.int64]
    sigma: Array
    probability: Array

    def pick(self, rows: NDArray[np.int64]) -> Said:
        """Return a copy of some times' rows."""
        return Said(self.position[rows], self.track[rows], self.sigma[rows], self.probability[rows])


def said_live(t: Array, devices: Sequence[str], frames: Sequence[TrackFrame], fresh: float = FRESH) -> Said:
    """Return what the newest frame at or before each of (n,) increasing times said of each of k devices.

    Of several rows with one name the most probable counts; a frame older than ``fresh`` seconds says nothing.
    """
    said = _nothing(len(frames) + 1, len(devices))  # the last row, which -1 picks, says nothing
    column: dict[str | None, int] = {device: number for number, device in enumerate(devices)}
    for row, frame in enumerate(frames):
        surest: dict[int, float] = {}
        for index, device in enumerate(frame.device):
            number = column.get(device)
            if number is None or frame.probability[index] <= surest.get(number, -1.0):
                continue
            surest[number] = frame.probability[index]
            said.position[row, number] = frame.x[index], frame.y[index]
            said.track[row, number] = UNSEEN if frame.state[index] == "unseen" else frame.track[index]
            said.sigma[row, number] = _longest(np.array(frame.covariance[index]))
            said.probability[row, number] = frame.probability[index]
    return said.pick(newest_frames(t, frames, fresh))


def said_later(
    t: Array,
    devices: Sequence[str],
    frames: Sequence[TrackFrame],
    revisions: Sequence[Revision],
    lag: float = 5.0,
    fresh: float = FRESH,
) -> Said:
    """Return what was known of each time ``lag`` seconds after it: what was said live, as revised since.

    For each device and time the last revision counts that covers the time and came no more than ``lag`` later. Between
    two of its points on one track the place is interpolated; elsewhere a point speaks for half a second.

    Args:
        t: (n,) increasing times.
        devices: k ids.
        frames: in the order of their times.
        revisions: in the order in which they came.
        lag: seconds; 0 gives what was said live and revised at once.
        fresh: seconds after which a frame says nothing.
    """
    said = said_live(t, devices, frames, fresh)
    column = {device: number for number, device in enumerate(devices)}
    for revision in revisions:
        of, points = np.array(revision.of, np.int64), _points(revision)
        at = np.array(revision.at, float)
        for number, (device, since) in enumerate(zip(revision.device, revision.since, strict=True)):
            if device not in column:
                continue
            first = np.searchsorted(t, max(since, revision.t - lag) - SAME)
            last = np.searchsorted(t, revision.t + SAME, side="right")
            rows, mine = slice(int(first), int(last)), np.flatnonzero(of == number)
            told = _along(t[rows], at[mine], points.pick(mine))
            for part in fields(Said):
                getattr(said, part.name)[rows, column[device]] = getattr(told, part.name)[:, 0]
    return said


def _points(revision: Revision) -> Said:
    """Return what a revision's points say, one row each."""
    return Said(
        position=np.column_stack([np.array(revision.x, float), np.array(revision.y, float)])[:, None],
        track=np.array(revision.track, np.int64)[:, None],
        sigma=_longest(np.array(revision.covariance, float).reshape(-1, 3))[:, None],
        probability=np.array(revision.probability, float)[:, None],
    )


def _along(t: Array, at: Array, points: Said) -> Said:
    """Return what one device's points, told at times ``at`` (oldest first), say of (n,) times ``t``."""
    if not len(at):
        return _nothing(len(t), 1)
    before = np.searchsorted(at, t + SAME, side="right") - 1
    after = np.minimum(before + 1, len(at) - 1)
    gap = at[after] - at[before]
    joined = (before >= 0) & (points.track[after, 0] == points.track[before, 0]) & (gap > 0.0) & (gap <= FRESH)
    share = np.where(joined, (t - at[before]) / np.where(joined, gap, 1.0), 0.0)
    spoken = (joined | ((before >= 0) & (t - at[before] <= HELD + SAME)))[:, None]
    between = points.position[before] + share[:, None, None] * (points.position[after] - points.position[before])
    return Said(
        position=np.where(spoken[..., None], between, np.nan),
        track=np.where(spoken, points.track[before], NOTHING),
        sigma=np.where(spoken, points.sigma[before], np.nan),
        probability=np.where(spoken, points.probability[before], 0.0),
    )


def _nothing(rows: int, columns: int) -> Said:
    return Said(
        np.full((rows, columns, 2), np.nan),
        np.full((rows, columns), NOTHING, np.int64),
        np.full((rows, columns), np.nan),
        np.zeros((rows, columns)),
    )


def _longest(covariance: Array) -> Array:
    """Return the standard deviation along the longer axis of (..., 3) covariances written xx, xy, yy."""
    xx, xy, yy = covariance[..., 0], covariance[..., 1], covariance[..., 2]
    longest: Array = np.sqrt(0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy))
    return longest
