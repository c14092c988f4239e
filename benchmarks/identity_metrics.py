"""Do the published names belong to the right people? Precision, recall, switches and time to identify, per device.

Who a track *is* gets decided apart from any name: at each time tracks and people are matched one to one within 1 m,
least total distance first (most pairs, then the shortest). A name is right if its track is matched to the person who
carries the device. So a name on the neighbour's track is wrong, even though it lies within 1 m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.people_followed import people_followed, stays
from benchmarks.track_reading import FRESH, named_positions, newest_frames
from benchmarks.tracking_metrics import GATE
from benchmarks.world_record import Truth
from shared.messages import TrackFrame

__all__ = ["UNNAMED", "IdentityScore", "bearers", "score_identity"]

Array = NDArray[np.float64]

UNNAMED = -2
"""No track bears the name; ``people_followed.NOBODY``: one does and follows no person."""


@dataclass(frozen=True)
class IdentityScore:
    """How well k devices were identified.

    Attributes:
        device: their ids.
        named: (k,) number of times the device's name was on a track.
        right: (k,) … and that track's person was the carrier.
        in_view: (k,) number of times the carrier was in view.
        right_in_view: (k,) … and the name was right.
        near: (k,) … and the track bearing the name was within the gate of the carrier.
        switches: (k,) how often the person bearing the name became another one, whatever lay between.
        stay: (s,) which device each stay is of: a carrier's time in view without a pause of more than 2 s.
        first: (s,) seconds from the beginning of the stay to the first right name; infinite if there is none.
        settled: (s,) … to the first right name after which no name in the stay is wrong; infinite if there is none.
    """

    device: Sequence[str]
    named: NDArray[np.int64]
    right: NDArray[np.int64]
    in_view: NDArray[np.int64]
    right_in_view: NDArray[np.int64]
    near: NDArray[np.int64]
    switches: NDArray[np.int64]
    stay: NDArray[np.int64]
    first: Array
    settled: Array

    @property
    def precision(self) -> Array:
        """(k,) share of the names that are right; NaN for a device never named."""
        return _ratio(self.right, self.named)

    @property
    def recall(self) -> Array:
        """(k,) share of the carrier's time in view with the right name; NaN for one never in view."""
        return _ratio(self.right_in_view, self.in_view)

    @property
    def located(self) -> Array:
        """(k,) share of the carrier's time in view in which the track with the name is within the gate."""
        return _ratio(self.near, self.in_view)

    @classmethod
    def together(cls, scores: Sequence[IdentityScore]) -> IdentityScore:
        """Return the scores of several runs or areas as one: their devices stand side by side, none is left out."""
        starts = np.cumsum([0, *(len(score.device) for score in scores)])
        columns = {
            name: np.concatenate([getattr(score, name) for score in scores])
            for name in ("named", "right", "in_view", "right_in_view", "near", "switches", "first", "settled")
        }
        return cls(
            device=[device for score in scores for device in score.device],
            stay=np.concatenate([score.stay + start for score, start in zip(scores, starts, strict=False)]),
            **columns,
        )

    def figures(self, prefix: str = "") -> dict[str, float | None]:
        """Return the figures of all devices together: shares are of all their times, times over all their stays."""
        median, p90 = (
            np.percentile(self.first, [50, 90], method="inverted_cdf") if len(self.first) else (np.nan, np.nan)
        )
        settled = np.percentile(self.settled, 50, method="inverted_cdf") if len(self.settled) else np.nan
        return {
            f"{prefix}id_precision": _share(self.right, self.named),
            f"{prefix}id_recall": _share(self.right_in_view, self.in_view),
            f"{prefix}located_within_1m": _share(self.near, self.in_view),
            f"{prefix}id_switches": int(self.switches.sum()),
            f"{prefix}seconds_to_identify": _finite(median),
            f"{prefix}seconds_to_identify_p90": _finite(p90),
            f"{prefix}seconds_to_settle": _finite(settled),
            f"{prefix}never_identified": float(np.isinf(self.first).mean()) if len(self.first) else None,
        }


def score_identity(
    truth: Truth, frames: Sequence[TrackFrame], gate: float = GATE, fresh: float = FRESH
) -> IdentityScore:
    """Score the names on published tracks at the times of the truth.

    Args:
        truth: who carries which device; thin its times out to score, say, once a second.
        frames: in the order of their times; the newest at or before a time speaks for it.
        gate: metres.
        fresh: a frame older than this, in seconds, says nothing.
    """
    carriers = np.array(truth.carriers(), np.int64)
    bearer = bearers(truth, frames, gate, fresh)
    in_view = truth.in_view[:, carriers]
    named: NDArray[np.bool_] = bearer != UNNAMED
    right: NDArray[np.bool_] = np.equal(bearer, carriers)
    off: Array = np.linalg.norm(named_positions(truth, frames, fresh) - truth.position[:, carriers], axis=2)
    stayed = [stays(truth.t, in_view[:, column]) for column in range(len(carriers))]
    timed = [
        _time_to_identify(truth.t[first : last + 1], named[first : last + 1, column], right[first : last + 1, column])
        for column in range(len(carriers))
        for first, last in stayed[column]
    ]
    return IdentityScore(
        device=[truth.device[place] or "" for place in carriers],
        named=named.sum(axis=0),
        right=right.sum(axis=0),
        in_view=in_view.sum(axis=0),
        right_in_view=(right & in_view).sum(axis=0),
        near=((off <= gate) & in_view).sum(axis=0),  # NaN, not located, is not near
        switches=np.array([_switches(bearer[:, column]) for column in range(len(carriers))], np.int64),
        stay=np.repeat(np.arange(len(carriers)), [len(found) for found in stayed]),
        first=np.array([first for first, _ in timed]),
        settled=np.array([settled for _, settled in timed]),
    )


def bearers(truth: Truth, frames: Sequence[TrackFrame], gate: float = GATE, fresh: float = FRESH) -> NDArray[np.int64]:
    """Return (n, k): which person, by place in ``truth.person``, bears each carrier's device; ``NOBODY``, ``UNNAMED``.

    Of several tracks with one name the most probable counts.
    """
    devices = {truth.device[place]: column for column, place in enumerate(truth.carriers())}
    found = np.full((len(truth.t), len(devices)), UNNAMED, np.int64)
    for row, newest in enumerate(newest_frames(truth.t, frames, fresh)):
        if newest < 0 or not any(device in devices for device in frames[newest].device):
            continue
        frame = frames[newest]
        person_of = people_followed(frame, truth.position[row], gate)
        for track in np.argsort(frame.probability, kind="stable"):  # the most probable has the last word
            column = devices.get(frame.device[track])
            if column is not None:
                found[row, column] = person_of[track]
    return found


def _switches(bearer: NDArray[np.int64]) -> int:
    people = bearer[bearer >= 0]
    return int((people[1:] != people[:-1]).sum())


def _time_to_identify(t: Array, named: NDArray[np.bool_], right: NDArray[np.bool_]) -> tuple[float, float]:
    if not right.any():
        return np.inf, np.inf
    first = float(t[np.argmax(right)] - t[0])
    wrong = np.flatnonzero(named & ~right)
    after = right.copy()
    if len(wrong):
        after[: wrong[-1] + 1] = False
    return first, float(t[np.argmax(after)] - t[0]) if after.any() else np.inf


def _ratio(part: NDArray[np.int64], whole: NDArray[np.int64]) -> Array:
    return np.where(whole > 0, part / np.maximum(whole, 1), np.nan)


def _share(part: NDArray[np.int64], whole: NDArray[np.int64]) -> float | None:
    return float(part.sum() / whole.sum()) if whole.sum() else None


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
