"""Pieces of tracks in which nothing was ever in doubt: detections linked only where no other link was possible.

[ravel-thesis §4.1] with its notes: people who hardly move are linked whatever their direction (i), a link that two
tracklets want is given to neither (ii), and no link is longer than a person can walk between two frames (iii).

The study looks twice a second, where half a metre of walk drowns the detector's noise. At higher rates it is the other
way round, so that motion is judged over half a second there too, and noise is allowed for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["TrackletSettings", "Tracklets", "change_of_motion", "grow_tracklets"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FAR, NEAR = 5.0, 2.5
"""Standard errors of a displacement allowed for in DT, and in who hardly moved: at thirty frames a second there are a
thousand links in half a minute, none of which noise may break."""
ENOUGH = 0.9
"""Share of the base line that will do: cameras do not keep time exactly."""


@dataclass(frozen=True)
class TrackletSettings:
    """What makes a link possible; the study's values are unpublished, these are the sheet's."""

    speed: float = 2.0
    """m/s; times the seconds between two frames it is DT, the farthest two linked detections lie apart, but for
    noise."""
    direction_weight: float = 0.5
    speed_weight: float = 0.5
    threshold: float = 0.5
    """Of the change of motion Q; a link must stay below it."""
    still: float = 0.25
    """Metres; who moved less over the base line may be linked whatever the direction, but for noise."""
    base: float = 0.5
    """Seconds, the base line over which motion is judged: between the study's frames."""
    noise: float = 0.1
    """Metres along each axis by which a detection errs. Allowed for where frames are closer than ``base``; from there
    on the rule is the study's to the letter."""
    longest_gap: float = 2.0
    """Seconds between two frames beyond which all tracklets end: nobody watched."""

    def reach(self, gap: float) -> float:
        """Return DT, the farthest in metres that two linked detections of frames ``gap`` seconds apart may lie."""
        return self.speed * gap + FAR * self._noise(gap)

    def hardly(self, gap: float) -> float:
        """Return the displacement over the base line, metres, below which direction says nothing."""
        return self.still + NEAR * self._noise(gap)

    def _noise(self, gap: float) -> float:
        """Return the standard error of a displacement that speed does not cover, metres."""
        return math.sqrt(2.0) * self.noise * max(1.0 - gap / self.base, 0.0)


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
    everything = np.concatenate([*places, np.zeros((0, 2))])
    when = np.repeat(t, np.diff(begin))
    tracklet, before = np.full(begin[-1], -1, np.int64), np.full(begin[-1], -1, np.int64)
    count = 0
    for frame, found in enumerate(places):
        here = np.arange(begin[frame], begin[frame + 1])
        gap = t[frame] - t[frame - 1] if frame else 0.0
        if 0.0 < gap <= s.longest_gap:
            last = np.arange(begin[frame - 1], begin[frame])
            middle = _back(last, t[frame] - ENOUGH * s.base, when, before)
            first = _back(before[middle], when[middle] - ENOUGH * s.base, when, before)
            velocity = _velocity(first, middle, everything, when, ENOUGH * s.base)
            span = t[frame] - when[middle]
            earlier, later = _only_links(everything[last], everything[middle], velocity, span, found, gap, s)
            before[here[later]] = last[earlier]
            tracklet[here[later]] = tracklet[last[earlier]]
        fresh = here[tracklet[here] < 0]
        tracklet[fresh] = count + np.arange(len(fresh))
        count += len(fresh)
    members = np.argsort(tracklet, kind="stable")
    return Tracklets(tracklet, members, np.searchsorted(tracklet[members], np.arange(count + 1)))


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


def _back(start: Indices, until: Array | float, when: Array, before: Indices) -> Indices:
    """Follow tracklets back from (m,) detections to the first at or before ``until``, or to where they begin.

    Args:
        start: (m,) detections, -1 for none, which stays none.
        until: (m,) seconds.
        when: (n,) seconds, of every detection.
        before: (n,) the detection linked to each from the past, -1 for none.
    """
    place = start.copy()
    while True:
        on = (place >= 0) & (when[place] > until) & (before[place] >= 0)
        if not on.any():
            return place
        place[on] = before[place[on]]


def _velocity(first: Indices, last: Indices, everything: Array, when: Array, least: float) -> Array:
    """Return (m, 2) m/s between two detections; NaN where there is none or less than ``least`` seconds apart."""
    span = np.where(first >= 0, when[last] - when[first], 0.0)
    known = span >= least
    velocity = np.full((len(first), 2), np.nan)
    velocity[known] = (everything[last[known]] - everything[first[known]]) / span[known, None]
    return velocity


def _only_links(
    last: Array, middle: Array, velocity: Array, span: Array, found: Array, gap: float, s: TrackletSettings
) -> tuple[Indices, Indices]:
    """Return the links between two frames' detections that are the only ones possible for both their ends.

    Args:
        last: (m, 2) the ends of the open tracklets.
        middle: (m, 2) where they were a base line before ``found``; from two frames a second on downwards, ``last``.
        velocity: (m, 2) their motion in the base line before that, m/s; NaN where they are too young.
        span: (m,) seconds from ``middle`` to ``found``.
        found: (k, 2) the next frame's detections.
        gap: seconds between the frames.
        s: what makes a link possible.
    """
    far = np.linalg.norm(found[None] - last[:, None], axis=2)
    moved = found[None] - middle[:, None]
    # A comparison with NaN is false: whoever has not moved yet may go anywhere.
    motion = moved / span[:, None, None]
    bent = change_of_motion(velocity[:, None], motion, s.direction_weight, s.speed_weight) >= s.threshold
    possible = (far < s.reach(gap)) & (~bent | (np.linalg.norm(moved, axis=2) < s.hardly(gap)))
    only = possible & (possible.sum(axis=0) == 1)[None, :] & (possible.sum(axis=1) == 1)[:, None]
    earlier, later = np.nonzero(only)
    return earlier, later
