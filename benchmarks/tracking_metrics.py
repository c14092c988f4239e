"""How good are these tracks? CLEAR MOT, identity and HOTA measures in metres, with a 1 m gate.

MOTA, IDF1 and their kin are computed by ``motmetrics`` on squared distances, HOTA by ``trackeval``'s own metric class
on the similarity it defines for points on the ground.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import motmetrics
import numpy as np
from numpy.typing import NDArray
from trackeval.metrics.hota import HOTA

from benchmarks.world_record import Truth
from shared.messages import TrackFrame, positions

__all__ = ["GATE", "FramesOfTruth", "TrackingScore", "TruthRows", "score_record", "score_tracks"]

Array = NDArray[np.float64]

GATE = 1.0
"""Metres; a track farther than this from a person does not show that person."""


class FramesOfTruth(Protocol):
    """Who was where, one row per person and frame; rows out of view are not scored."""

    @property
    def frame(self) -> NDArray[np.int64]:
        """(n,) numbers of the frames."""
        ...

    @property
    def person(self) -> NDArray[np.int64]:
        """(n,) ids."""
        ...

    @property
    def position(self) -> NDArray[np.float64]:
        """(n, 2) metres."""
        ...

    @property
    def in_view(self) -> NDArray[np.bool_]:
        """(n,) whether a camera could see the person's feet."""
        ...


@dataclass(frozen=True)
class TrackingScore:
    """Shares (MOTA may be negative), counts, and the error of matched tracks in metres (NaN if nothing matched)."""

    mota: float
    idf1: float
    switches: int
    precision: float
    recall: float
    rmse: float
    fragmentations: int
    frames: int
    hota: float = math.nan
    detection_accuracy: float = math.nan
    association_accuracy: float = math.nan

    def __str__(self) -> str:
        """One line for a table."""
        return (
            f"MOTA {self.mota:.3f} IDF1 {self.idf1:.3f} switches {self.switches} P {self.precision:.3f} "
            f"R {self.recall:.3f} RMSE {self.rmse:.3f} m HOTA {self.hota:.3f} over {self.frames} frames"
        )


@dataclass(frozen=True)
class TruthRows:
    """Truth as rows, one per person and frame; see ``FramesOfTruth``."""

    frame: NDArray[np.int64]
    person: NDArray[np.int64]
    position: Array
    in_view: NDArray[np.bool_]

    @classmethod
    def of(cls, truth: Truth) -> TruthRows:
        """Return the rows of a world's truth: frames number its times, persons are places in ``truth.person``."""
        frame, person = np.nonzero(np.isfinite(truth.position).all(axis=2))
        return cls(frame, person, truth.position[frame, person], truth.in_view[frame, person])


def score_tracks(
    truth: FramesOfTruth, tracks: Mapping[int, TrackFrame], first: int, last: int, gate: float = GATE
) -> TrackingScore:
    """Compare tracks with the truth. Devices that no camera sees are followed by their radio and are no tracks here.

    Args:
        truth: the people really in view.
        tracks: what was published, by number of the truth's frame; a frame without an entry counts as empty.
        first: the first frame scored, and ``last``, the last one, inclusive.
        last: see ``first``.
        gate: metres.
    """
    accumulator = motmetrics.MOTAccumulator(auto_id=True)
    order = np.argsort(truth.frame, kind="stable")
    begins = np.searchsorted(truth.frame[order], np.arange(first, last + 2))
    people: list[NDArray[np.int64]] = []
    found: list[NDArray[np.int64]] = []
    distances: list[Array] = []
    for number in range(first, last + 1):
        rows = order[begins[number - first] : begins[number - first + 1]]
        rows = rows[truth.in_view[rows]]
        frame = tracks.get(number)
        seen = np.array([] if frame is None else [state != "unseen" for state in frame.state], np.bool_)
        places = np.zeros((0, 2)) if frame is None else positions(frame)[seen]
        apart = np.linalg.norm(truth.position[rows][:, None] - places[None], axis=2)
        people.append(truth.person[rows])
        found.append(np.array([] if frame is None else frame.track, np.int64)[seen])
        distances.append(apart)
        accumulator.update(people[-1], found[-1], np.where(apart <= gate, apart**2, np.nan))
    names = ["mota", "motp", "idf1", "num_switches", "precision", "recall", "num_fragmentations"]
    row = motmetrics.metrics.create().compute(accumulator, metrics=names).iloc[0]
    hota, detection, association = _hota(people, found, distances, gate)
    return TrackingScore(
        mota=float(row["mota"]),
        idf1=float(row["idf1"]),
        switches=int(row["num_switches"]),
        precision=float(row["precision"]),
        recall=float(row["recall"]),
        rmse=math.sqrt(float(row["motp"])),
        fragmentations=int(row["num_fragmentations"]),
        frames=last - first + 1,
        hota=hota,
        detection_accuracy=detection,
        association_accuracy=association,
    )


def score_record(truth: Truth, frames: Sequence[TrackFrame], every: int = 1, gate: float = GATE) -> TrackingScore:
    """Compare the tracks of a run with a world's truth, at every ``every``-th time of the truth.

    At each time the newest frame at or before it is scored, unless it is older than one and a half of the intervals
    between frames (or between scored times, if those are longer): then nothing was said.

    Args:
        truth: of the area the tracks are of.
        frames: in the order of their times.
        every: scores fewer times where the truth is told more often than is of use.
        gate: metres.
    """
    times = truth.t[::every]
    thinned = Truth(times, truth.person, truth.device, truth.position[::every], truth.in_view[::every])
    told = np.array([frame.t for frame in frames])
    if not len(told) or not len(times):
        return score_tracks(TruthRows.of(thinned), {}, 0, len(times) - 1, gate)
    newest = np.searchsorted(told, times + 1e-6, side="right") - 1
    interval = max(_interval(times), _interval(told))
    current = (newest >= 0) & (times - told[newest] <= 1.5 * interval + 1e-6)
    tracks = {int(number): frames[newest[number]] for number in np.flatnonzero(current)}
    return score_tracks(TruthRows.of(thinned), tracks, 0, len(times) - 1, gate)


def _interval(times: Array) -> float:
    return float(np.median(np.diff(times))) if len(times) > 1 else 0.0


def _hota(
    people: Sequence[NDArray[np.int64]],
    tracks: Sequence[NDArray[np.int64]],
    distances: Sequence[Array],
    gate: float,
) -> tuple[float, float, float]:
    """Return HOTA, DetA and AssA, each averaged over the localisation thresholds 0.05 … 0.95.

    Similarity is ``max(0, 1 - distance / (2 gate))``: TrackEval's own for MOT15 3D, in which a similarity of 0.5 is a
    distance of the gate (``trackeval.datasets._base_dataset``, ``_calculate_euclidean_similarity``).
    """
    person_ids, of_people = np.unique(np.concatenate([*people, np.zeros(0, np.int64)]), return_inverse=True)
    track_ids, of_tracks = np.unique(np.concatenate([*tracks, np.zeros(0, np.int64)]), return_inverse=True)
    if not len(of_people) and not len(of_tracks):
        return math.nan, math.nan, math.nan
    result = HOTA().eval_sequence(
        {
            "num_gt_dets": len(of_people),
            "num_tracker_dets": len(of_tracks),
            "num_gt_ids": len(person_ids),
            "num_tracker_ids": len(track_ids),
            "num_timesteps": len(people),
            "gt_ids": np.split(of_people, np.cumsum([len(ids) for ids in people])[:-1]),
            "tracker_ids": np.split(of_tracks, np.cumsum([len(ids) for ids in tracks])[:-1]),
            "similarity_scores": [np.maximum(0.0, 1.0 - apart / (2.0 * gate)) for apart in distances],
        }
    )
    return tuple(float(np.mean(result[name])) for name in ("HOTA", "DetA", "AssA"))  # type: ignore[return-value]
