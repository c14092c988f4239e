"""How good are these tracks? CLEAR MOT and identity measures in metres, by ``motmetrics``, with a 1 m gate."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import motmetrics
import numpy as np
from numpy.typing import NDArray

from shared.messages import TrackFrame, positions

__all__ = ["GATE", "FramesOfTruth", "TrackingScore", "score_tracks"]

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

    def __str__(self) -> str:
        """One line for a table."""
        return (
            f"MOTA {self.mota:.3f} IDF1 {self.idf1:.3f} switches {self.switches} P {self.precision:.3f} "
            f"R {self.recall:.3f} RMSE {self.rmse:.3f} m over {self.frames} frames"
        )


def score_tracks(
    truth: FramesOfTruth, tracks: Mapping[int, TrackFrame], first: int, last: int, gate: float = GATE
) -> TrackingScore:
    """Compare tracks with the truth.

    Args:
        truth: the people really in view.
        tracks: what was published, by number of the truth's frame; a frame without an entry counts as empty.
        first: the first frame scored, and ``last``, the last one, inclusive.
        last: see ``first``.
        gate: metres.
    """
    accumulator = motmetrics.MOTAccumulator(auto_id=True)
    for number in range(first, last + 1):
        rows = (truth.frame == number) & truth.in_view
        frame = tracks.get(number)
        ids = [] if frame is None else frame.track
        places = np.zeros((0, 2)) if frame is None else positions(frame)
        apart = np.linalg.norm(truth.position[rows][:, None] - places[None], axis=2)
        accumulator.update(truth.person[rows], ids, np.where(apart <= gate, apart**2, np.nan))
    names = ["mota", "motp", "idf1", "num_switches", "precision", "recall", "num_fragmentations"]
    row = motmetrics.metrics.create().compute(accumulator, metrics=names).iloc[0]
    return TrackingScore(
        mota=float(row["mota"]),
        idf1=float(row["idf1"]),
        switches=int(row["num_switches"]),
        precision=float(row["precision"]),
        recall=float(row["recall"]),
        rmse=math.sqrt(float(row["motp"])),
        fragmentations=int(row["num_fragmentations"]),
        frames=last - first + 1,
    )
