"""How well were phones found among anonymous people? Located trajectories, names per second, time to the first name.

*Located*: F1 of where a device was said to be against where its carrier was, label fixed, within 1 m, over the times of
the truth (IDF1 with the matching given). Whoever puts a device on a track claims a place, and so does whoever follows
one that no camera sees to within the gate (by its own standard deviation); a vaguer row claims nothing. A wrong claim
counts against, wherever the carrier is; a right one counts for it in view, and neither way out of view, where there is
nothing to be found. ``in_view`` is the laxer figure: claims of unseen devices count in view only, names on tracks
always. *Names*: once a second; who a track is, is the person matched to it most often within a second before and after,
so that a track that passes through another is judged by whom it follows. A name on a track that follows nobody is
wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from benchmarks.people_followed import NOBODY, people_followed, stays
from benchmarks.revised import UNSEEN, Said
from benchmarks.track_reading import newest_frames
from benchmarks.tracking_metrics import GATE
from benchmarks.world_record import Truth
from shared.messages import TrackFrame

__all__ = ["Followed", "PhoneScore", "followed", "score_phones"]

Array = NDArray[np.float64]

AROUND = 1.0
"""Seconds before and after in which the person a track follows is counted."""
SECOND = 1.0


@dataclass(frozen=True)
class Followed:
    """Whom each track follows: rows of one time (by place in the truth's times), track and person, sorted by track.

    Attributes:
        track, row, person: (r,) integers; ``person`` is a place in ``truth.person`` or ``NOBODY``.
        t: (n,), the truth's times.
    """

    track: NDArray[np.int64]
    row: NDArray[np.int64]
    person: NDArray[np.int64]
    t: Array

    def whom(self, track: int, row: int) -> int:
        """Return the person whom a track follows most of the time around ``row``; ``NOBODY`` where nobody."""
        low, high = np.searchsorted(self.track, [track, track + 1])
        near = np.abs(self.t[self.row[low:high]] - self.t[row]) <= AROUND
        people = self.person[low:high][near]
        if not len(people):
            return NOBODY
        ids, counts = np.unique(people, return_counts=True)
        return int(ids[np.argmax(counts)])


def followed(truth: Truth, frames: Sequence[TrackFrame], gate: float = GATE) -> Followed:
    """Match tracks and people at each time one to one: most pairs within ``gate`` metres, then the shortest."""
    rows: list[tuple[int, int, int]] = []
    for row, newest in enumerate(newest_frames(truth.t, frames)):
        if newest < 0:
            continue
        frame = frames[newest]
        whom = people_followed(frame, truth.position[row], gate)
        rows += [
            (track, row, person)
            for track, person, state in zip(frame.track, whom.tolist(), frame.state, strict=True)
            if state != "unseen"
        ]
    table = np.array(rows, np.int64).reshape(-1, 3)
    table = table[np.lexsort((table[:, 1], table[:, 0]))]
    return Followed(table[:, 0], table[:, 1], table[:, 2], truth.t)


@dataclass(frozen=True)
class PhoneScore:
    """Counts of k devices, and what is pooled over them.

    Attributes:
        found, claimed, present: (k,), times at which the device was rightly said to be where its carrier was in view, a
            place was claimed of it (right claims out of view left out), and its carrier was in view.
        claimed_in_view: (k,), the same as ``claimed`` by the laxer rule.
        right, named, right_seen, seen: (k,), seconds with a right name, with any, with a right one while the carrier
            was in view, and in view.
        error: (e,) metres, at times in view at which a place was told.
        first: (s,) seconds from the beginning of each stay in view to the first right name; infinite for none.
    """

    found: NDArray[np.int64]
    claimed: NDArray[np.int64]
    present: NDArray[np.int64]
    claimed_in_view: NDArray[np.int64]
    right: NDArray[np.int64]
    named: NDArray[np.int64]
    right_seen: NDArray[np.int64]
    seen: NDArray[np.int64]
    error: Array
    first: Array

    @classmethod
    def together(cls, scores: Sequence[PhoneScore]) -> PhoneScore:
        """Return the scores of several runs as one."""
        return cls(*(np.concatenate([getattr(score, part.name) for score in scores]) for part in fields(cls)))

    @property
    def f1(self) -> float:
        """Of located trajectories, all devices together; NaN where nobody was in view."""
        return self._f1(self.claimed)

    def _f1(self, claimed: NDArray[np.int64]) -> float:
        whole = int(claimed.sum() + self.present.sum())
        return 2.0 * int(self.found.sum()) / whole if whole else float("nan")

    def figures(self, suffix: str) -> dict[str, float | None]:
        """Return the figures by name, each with the suffix."""
        median, p90 = np.percentile(self.error, [50, 90]) if len(self.error) else (np.nan, np.nan)
        first = np.percentile(self.first, [50, 90], method="inverted_cdf") if len(self.first) else [np.nan, np.nan]
        values = {
            "idf1": self.f1,
            "precision": _share(self.right, self.named),
            "recall": _share(self.right_seen, self.seen),
            "error_p50": float(median),
            "error_p90": float(p90),
            "seconds_to_identify": float(first[0]),
            "seconds_to_identify_p90": float(first[1]),
            "never_identified": float(np.isinf(self.first).mean()) if len(self.first) else float("nan"),
        }
        named = {f"{name}_{suffix}": value for name, value in values.items()}
        named[f"idf1_{suffix}_in_view"] = self._f1(self.claimed_in_view)
        return {name: value if np.isfinite(value) else None for name, value in named.items()}


def score_phones(
    truth: Truth, whom: Followed, said: Said, devices: Sequence[str] | None = None, gate: float = GATE
) -> PhoneScore:
    """Score what was said of each carrier's device.

    Args:
        truth: of the same times as ``said``.
        whom: whom the tracks follow.
        said: live or later.
        devices: only these count; None: all.
        gate: metres.
    """
    carriers = [
        (column, place)
        for column, place in enumerate(truth.carriers())
        if devices is None or truth.device[place] in devices
    ]
    columns = np.array([column for column, _ in carriers], np.int64)
    people = np.array([place for _, place in carriers], np.int64)
    in_view = truth.in_view[:, people]
    off: Array = np.linalg.norm(said.position[:, columns] - truth.position[:, people], axis=2)
    track, sigma = said.track[:, columns], said.sigma[:, columns]
    named, exact = track > UNSEEN, (track == UNSEEN) & (sigma <= gate)
    claimed, near = named | exact, off <= gate  # NaN is not near
    right = np.zeros(named.shape, bool)
    for row, column in zip(*np.nonzero(named), strict=True):
        right[row, column] = whom.whom(int(track[row, column]), int(row)) == people[column]
    seconds = np.unique(np.searchsorted(truth.t, np.arange(truth.t[0], truth.t[-1] + 1e-6, SECOND) - 1e-6))
    seconds = seconds[seconds < len(truth.t)]
    first = [
        _first(truth.t[begin : end + 1], right[begin : end + 1, column])
        for column in range(len(carriers))
        for begin, end in stays(truth.t, in_view[:, column])
    ]
    told = in_view & np.isfinite(off)
    return PhoneScore(
        found=(claimed & in_view & near).sum(axis=0),
        claimed=(claimed & (in_view | ~near)).sum(axis=0),
        present=in_view.sum(axis=0),
        claimed_in_view=(named | (exact & in_view)).sum(axis=0),
        right=right[seconds].sum(axis=0),
        named=named[seconds].sum(axis=0),
        right_seen=(right & in_view)[seconds].sum(axis=0),
        seen=in_view[seconds].sum(axis=0),
        error=off[told],
        first=np.array(first, float),
    )


def _first(t: Array, right: NDArray[np.bool_]) -> float:
    return float(t[np.argmax(right)] - t[0]) if right.any() else np.inf


def _share(part: NDArray[np.int64], whole: NDArray[np.int64]) -> float:
    return float(part.sum() / whole.sum()) if whole.sum() else float("nan")
