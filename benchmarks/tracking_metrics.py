"""How good are these tracks? CLEAR MOT and identity measures in metres, by ``motmetrics``, with a 1 m gate."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import motmetrics
import numpy as np
from numpy.typing import NDArray

from shared.messages import TrackFrame

__all__ = ["TrackingScores", "Truth", "score_tracks"]

GATE = 1.0
"""Metres; a track farther than this from a person does not show that person."""


@dataclass(frozen=True)
class Truth:
    """Who was really where at one time.

    Attributes:
        t: seconds.
        person: (n,), ids.
        places: (n, 2), metres.
    """

    t: float
    person: NDArray[np.int64]
    places: NDArray[np.float64]


@dataclass(frozen=True)
class TrackingScores:
    """Shares between 0 and 1 (MOTA may be negative), numbers, metres."""

    mota: float
    idf1: float
    switches: int
    precision: float
    recall: float
    rmse_m: float
    fragmentations: int
    frames: int

    def __str__(self) -> str:
        """One line for a table."""
        return (
            f"MOTA {self.mota:.3f} IDF1 {self.idf1:.3f} switches {self.switches} P {self.precision:.3f} "
            f"R {self.recall:.3f} RMSE {self.rmse_m:.3f} m over {self.frames} frames"
        )


def score_tracks(truth: Iterable[Truth], frames: Iterable[TrackFrame], *, tolerance: float = 0.04) -> TrackingScores:
    """Compare tracks with the truth.

    Args:
        truth: what was annotated, one entry per annotated time (also when nobody was there).
        frames: what was published; for each annotated time the frame nearest in ``t`` within ``tolerance`` counts,
            and none means nothing was tracked.
        tolerance: seconds.
    """
    ordered = sorted(truth, key=lambda entry: entry.t)
    published = sorted(frames, key=lambda frame: frame.t)
    times = np.array([frame.t for frame in published])
    accumulator = motmetrics.MOTAccumulator(auto_id=True)
    for entry in ordered:
        found = _nearest(times, entry.t, tolerance)
        tracks = np.zeros(0, np.int64) if found is None else np.asarray(published[found].track, np.int64)
        places = np.zeros((0, 2))
        if found is not None:
            places = np.column_stack([published[found].x, published[found].y]).reshape(-1, 2)
        apart = np.linalg.norm(entry.places[:, None] - places[None], axis=2)
        accumulator.update(entry.person, tracks, np.where(apart <= GATE, apart**2, np.nan))
    metrics = motmetrics.metrics.create()
    names = ["mota", "motp", "idf1", "num_switches", "precision", "recall", "num_fragmentations"]
    row = metrics.compute(accumulator, metrics=names).iloc[0]
    return TrackingScores(
        mota=float(row["mota"]),
        idf1=float(row["idf1"]),
        switches=int(row["num_switches"]),
        precision=float(row["precision"]),
        recall=float(row["recall"]),
        rmse_m=float(np.sqrt(row["motp"])),
        fragmentations=int(row["num_fragmentations"]),
        frames=len(ordered),
    )


def _nearest(times: NDArray[np.float64], t: float, tolerance: float) -> int | None:
    if not len(times):
        return None
    after = int(np.searchsorted(times, t))
    best = min((i for i in (after - 1, after) if 0 <= i < len(times)), key=lambda i: abs(times[i] - t))
    return best if abs(times[best] - t) <= tolerance else None
