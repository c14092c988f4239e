"""What did fusion say of each device at each time, and what did it say of the same times a few seconds later?

A ``Said`` is what there is to score: where, on which track, seen by a camera or not. ``said_live`` reads it off the
published frames; ``said_later`` takes the revisions in that came soon enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.track_reading import FRESH, newest_frames
from benchmarks.world_record import Truth
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
    """

    position: Array
    track: NDArray[np.int64]
    sigma: Array

    def copy(self) -> Said:
        """Return a copy that may be written to."""
        return Said(self.position.copy(), self.track.copy(), self.sigma.copy())


def said_live(truth: Truth, frames: Sequence[TrackFrame], fresh: float = FRESH) -> Said:
    """Return what the newest frame at or before each time of the truth said of each carrier's device.

    Of several rows with one name the most probable counts; one older than ``fresh`` seconds says nothing.
    """
    devices = [truth.device[place] for place in truth.carriers()]
    said = _nothing(len(frames) + 1, len(devices))  # the last row, which -1 picks, says nothing
    column = {device: number for number, device in enumerate(devices)}
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
    newest = newest_frames(truth.t, frames, fresh)
    return Said(said.position[newest], said.track[newest], said.sigma[newest])


def said_later(
    truth: Truth, frames: Sequence[TrackFrame], revisions: Sequence[Revision], lag: float = 5.0, fresh: float = FRESH
) -> Said:
    """Return what was known of each time ``lag`` seconds after it: what was said live, as revised since.

    For each device and time the last revision counts that covers the time and came no more than ``lag`` later. Between
    two of its points on one track the place is interpolated; elsewhere a point speaks for half a second.

    Args:
        truth: gives times and carriers.
        frames: in the order of their times.
        revisions: in the order in which they came.
        lag: seconds; 0 gives what was said live and revised at once.
        fresh: seconds after which a frame says nothing.
    """
    said = said_live(truth, frames, fresh).copy()
    column = {truth.device[place]: number for number, place in enumerate(truth.carriers())}
    for revision in revisions:
        of, at = np.array(revision.of, np.int64), np.array(revision.at)
        track = np.array(revision.track, np.int64)
        place = np.column_stack([np.array(revision.x, float), np.array(revision.y, float)])
        sigma = _longest(np.array(revision.covariance, float).reshape(-1, 3))
        for number, (device, since) in enumerate(zip(revision.device, revision.since, strict=True)):
            if device not in column:
                continue
            first = np.searchsorted(truth.t, max(since, revision.t - lag) - SAME)
            last = np.searchsorted(truth.t, revision.t + SAME, side="right")
            rows, mine = slice(int(first), int(last)), np.flatnonzero(of == number)
            where = (rows, column[device])
            said.position[where], said.track[where], said.sigma[where] = _along(
                truth.t[rows], at[mine], place[mine], track[mine], sigma[mine]
            )
    return said


def _along(
    t: Array, at: Array, place: Array, track: NDArray[np.int64], sigma: Array
) -> tuple[Array, NDArray[np.int64], Array]:
    """Return place (n, 2), track (n,) and sigma (n,) at times ``t`` of a device's points, oldest first."""
    told = _nothing(len(t), 1)
    if not len(at):
        return told.position[:, 0], told.track[:, 0], told.sigma[:, 0]
    before = np.searchsorted(at, t + SAME, side="right") - 1
    after = np.minimum(before + 1, len(at) - 1)
    gap = at[after] - at[before]
    known = before >= 0
    joined = known & (track[after] == track[before]) & (gap > 0.0) & (gap <= FRESH)
    share = np.where(joined, (t - at[before]) / np.where(joined, gap, 1.0), 0.0)
    spoken = joined | (known & (t - at[before] <= HELD + SAME))
    between = place[before] + share[:, None] * (place[after] - place[before])
    return (
        np.where(spoken[:, None], between, np.nan),
        np.where(spoken, track[before], NOTHING),
        np.where(spoken, sigma[before], np.nan),
    )


def _nothing(rows: int, columns: int) -> Said:
    return Said(
        np.full((rows, columns, 2), np.nan),
        np.full((rows, columns), NOTHING, np.int64),
        np.full((rows, columns), np.nan),
    )


def _longest(covariance: Array) -> Array:
    """Return the standard deviation along the longer axis of (..., 3) covariances written xx, xy, yy."""
    xx, xy, yy = covariance[..., 0], covariance[..., 1], covariance[..., 2]
    longest: Array = np.sqrt(0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy))
    return longest
