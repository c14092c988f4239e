"""Pieces of tracks in which nothing was ever in doubt: detections linked only where no other link was possible.

[ravel-thesis §4.1] with its notes: people who hardly move are linked whatever their direction (i), a link that two
tracklets want is given to neither (ii), and no link is longer than a person can walk between two frames (iii).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["TrackletSettings", "Tracklets", "change_of_motion", "grow_tracklets"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class TrackletSettings:
    """What makes a link possible; the study's values are unpublished, these are the sheet's."""

    speed: float = 2.0
    """m/s; times the seconds between two frames it is DT, the farthest two linked detections lie apart."""
    direction_weight: float = 0.5
    speed_weight: float = 0.5
    threshold: float = 0.5
    """Of the change of motion Q; a link must stay below it."""
    still: float = 0.25
    """Metres; a link shorter than this is possible whatever its direction."""
    longest_gap: float = 2.0
    """Seconds between two frames beyond which all tracklets end: nobody watched."""


@dataclass(frozen=True)
class Tracklets:
    """Which of n detections belong together, in k tracklets, each in one.

    Attributes:
        tracklet: (n,) number of each detection's tracklet; they are numbered by their first detections.
        members: (n,) detections, tracklet by tracklet, in order of time.
        start: (k + 1,) where each tracklet begins in ``members``.
    """

    tracklet: Indices
    members: Indices
    start: Indices

    def __len__(self) -> int:
        """How many tracklets there are."""
        return len(self.start) - 1

    def __getitem__(self, number: int) -> Indices:
        """Return the detections of one tracklet, in order of time."""
        return self.members[self.start[number] : self.start[number + 1]]


def grow_tracklets(t: Array, places: Sequence[Array], settings: TrackletSettings | None = None) -> Tracklets:
    """Link the detections of one camera wherever only one link is possible.

    Args:
        t: (f,) increasing times of its frames, seconds.
        places: of each frame, its detections (k, 2), metres. They are numbered through from 0, frame by frame.
        settings: what makes a link possible.

    Raises:
        ValueError: times that do not increase, or more or fewer of them than frames.
    """
    s = settings or TrackletSettings()
    t = np.asarray(t, dtype=np.float64)
    if len(t) != len(places):
        raise ValueError(f"{len(t)} times of {len(places)} frames")
    if not (np.diff(t) > 0.0).all():
        raise ValueError("the times of the frames must increase")
    begin = np.concatenate([[0], np.cumsum([len(found) for found in places])]).astype(np.int64)
    tracklet = np.full(begin[-1], -1, np.int64)
    count = 0
    last, velocity = np.zeros((0, 2)), np.zeros((0, 2))
    for frame, found in enumerate(places):
        gap = t[frame] - t[frame - 1] if frame else 0.0
        earlier, later = _only_links(last, velocity, found, gap, s) if 0.0 < gap <= s.longest_gap else _NO_LINKS
        before = begin[frame - 1] if frame else 0
        here = tracklet[begin[frame] : begin[frame + 1]]
        here[later] = tracklet[before + earlier]
        fresh = np.flatnonzero(here < 0)
        here[fresh] = count + np.arange(len(fresh))
        count += len(fresh)
        velocity = np.full((len(found), 2), np.nan)
        velocity[later] = (found[later] - last[earlier]) / gap if len(later) else 0.0
        last = found
    members = np.argsort(tracklet, kind="stable")
    return Tracklets(tracklet, members, np.searchsorted(tracklet[members], np.arange(count + 1)))


_NO_LINKS = np.zeros(0, np.int64), np.zeros(0, np.int64)


def change_of_motion(before: Array, after: Array, direction_weight: float = 0.5, speed_weight: float = 0.5) -> Array:
    """Return Q [eqs 3.1 and 3.2] of (..., 2) motions: 0 for a straight, even walk.

    Of the two parts one is 1 - cos of the turn, 0 to 2, the other one minus the ratio of the geometric to the
    arithmetic mean of the two speeds, 0 to 1. Who stands has no direction: neither part counts where both stand, and a
    start or a stop counts as a right angle.
    """
    one, two = np.linalg.norm(before, axis=-1), np.linalg.norm(after, axis=-1)
    both, product = one + two, one * two
    cosine = np.sum(before * after, axis=-1) / np.where(product > 0.0, product, 1.0)
    turn = np.where(both > 0.0, 1.0 - cosine, 0.0)
    uneven = np.where(both > 0.0, 1.0 - 2.0 * np.sqrt(product) / np.where(both > 0.0, both, 1.0), 0.0)
    quality: Array = direction_weight * turn + speed_weight * uneven
    return quality


def _only_links(last: Array, velocity: Array, found: Array, gap: float, s: TrackletSettings) -> tuple[Indices, Indices]:
    """Return the links between two frames' detections that are the only ones possible for both their ends.

    Args:
        last: (m, 2) the ends of the open tracklets.
        velocity: (m, 2) their last motion, m/s; NaN where there was none.
        found: (k, 2) the next frame's detections.
        gap: seconds between the frames.
        s: what makes a link possible.
    """
    moved = found[None] - last[:, None]
    far = np.linalg.norm(moved, axis=2)
    # A comparison with NaN is false: whoever has not moved yet may go anywhere.
    bent = change_of_motion(velocity[:, None], moved / gap, s.direction_weight, s.speed_weight) >= s.threshold
    possible = (far < s.speed * gap) & (~bent | (far < s.still))
    only = possible & (possible.sum(axis=0) == 1)[None, :] & (possible.sum(axis=1) == 1)[:, None]
    earlier, later = np.nonzero(only)
    return earlier, later
