"""Does quality tell good stretches from bad ones? Judged stretches of a record beside the truth, and with lies added.

What learning sees of a run: detections, radio, steps, track frames and revisions, in the order of the bus.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from benchmarks.fusion_run import FusionRun
from benchmarks.world_record import Truth, WorldRecord
from services.learning.tracks.assembler import StretchAssembler
from services.learning.tracks.quality import QualityJudge
from services.learning.tracks.sight import SightScore
from services.learning.tracks.stretch import Stretch
from services.learning.tracks.verdict import Verdict
from shared.messages import DetectionFrame, RadioScan
from shared.radio import PathLoss
from shared.site import camera_views

__all__ = ["Judged", "agreement", "judged", "radio_of_area", "stretches_of", "with_swapped_radio"]

Array = NDArray[np.float64]

NEAR = 1.0
"""Metres from the carrier within which a name is right."""
BUS = 0.3
"""Seconds after a track frame's time by which what it rests on has come."""


@dataclass(frozen=True)
class Judged:
    """A stretch, what was thought of it, and what was true.

    Attributes:
        stretch: see ``services.learning.tracks.stretch``.
        verdict: printed Q, rate, whether it may teach.
        rmse: metres from the device's carrier, root mean square; NaN where the carrier was never on the floor.
        right: share of the time within ``NEAR`` of the carrier.
    """

    stretch: Stretch
    verdict: Verdict
    rmse: float
    right: float


def radio_of_area(record: WorldRecord) -> PathLoss:
    """Return the radio model of the record's area as its site file says."""
    floor = record.site.area(record.area).floor
    return PathLoss.of([point for point in record.site.access_points if point.floor == floor])


def stretches_of(record: WorldRecord, run: FusionRun, window: float = 60.0) -> list[Stretch]:
    """Return the stretches of a run over a record, in order of their ends; the longest lasts ``window`` seconds."""
    assembler = StretchAssembler(radio_of_area(record).names, window)
    sight = SightScore(camera_views(record.site, record.area).each)
    arrivals, revisions = iter(record.arrivals), iter(run.revisions)
    arrival, revision = next(arrivals, None), next(revisions, None)
    closed: list[Stretch] = []
    for number, frame in enumerate(run.frames):
        while arrival is not None and arrival[0] <= frame.t + BUS:
            message = arrival[1]
            if isinstance(message, DetectionFrame):
                sight.take_detections(message)
            elif isinstance(message, RadioScan):
                assembler.take_scan(message)
            else:
                assembler.take_motion(message)
            arrival = next(arrivals, None)
        assembler.take_frame(frame, sight.score(frame))
        while revision is not None and revision.t <= frame.t:
            assembler.take_revision(revision)
            revision = next(revisions, None)
        if number % 15 == 0:
            closed += assembler.close()
    closed += assembler.close(run.frames[-1].t + 100.0)
    return sorted(closed, key=lambda stretch: float(stretch.t[-1]))


def judged(
    record: WorldRecord, stretches: Sequence[Stretch], alter: Callable[[int, Stretch], Stretch] = lambda _, s: s
) -> list[Judged]:
    """Return the verdicts on stretches in order of their ends, beside the truth.

    Args:
        record: for its radio and its truth.
        stretches: of it.
        alter: what is judged in place of a stretch, by its number; to lie on purpose.
    """
    radio = radio_of_area(record)
    judge = QualityJudge(len(radio.names))
    found = []
    for number, stretch in enumerate(stretches):
        verdict = judge.judge(alter(number, stretch), radio)
        found.append(Judged(stretch, verdict, *_error(record.truth, stretch)))
    return found


def with_swapped_radio(record: WorldRecord, stretch: Stretch, device: str) -> Stretch:
    """Return the stretch with what another device heard at that time in place of its own readings."""
    column = {name: number for number, name in enumerate(radio_of_area(record).names)}
    rows = [
        (scan.t, column[name], level)
        for scan in record.scans[device]
        if stretch.t[0] <= scan.t <= stretch.t[-1]
        for name, level in zip(scan.access_point, scan.rssi, strict=True)
        if name in column
    ]
    heard = np.array(sorted(rows), float).reshape(-1, 3)
    where = [np.interp(heard[:, 0], stretch.t, stretch.place[:, axis]) for axis in (0, 1)]
    return dataclasses.replace(
        stretch,
        scan_t=heard[:, 0],
        point=heard[:, 1].astype(np.int64),
        level=heard[:, 2],
        scan_place=np.column_stack(where),
        scan_spread=np.zeros(len(heard)),
    )


def agreement(found: Sequence[Judged], least: float = 8.0) -> dict[str, float]:
    """Return how well quality agrees with the truth, over stretches of at least ``least`` seconds.

    Returns:
        Spearman's correlation of RMSE with the printed sum and with the rate; of the time of good stretches the share
        whose name is right, before and after judging; the share of the right time that may teach.
    """
    long = [one for one in found if one.stretch.seconds >= least and np.isfinite(one.rmse)]
    rmse = np.array([one.rmse for one in long])
    seconds = np.array([one.stretch.seconds for one in long])
    right = np.array([one.right for one in long])
    good = np.array([one.verdict.good for one in long], np.bool_)
    return {
        "stretches": float(len(long)),
        "printed_rmse_spearman": float(spearmanr([one.verdict.printed for one in long], rmse)[0]),
        "rate_rmse_spearman": float(spearmanr([one.verdict.rate for one in long], rmse)[0]),
        "right_before": float(right @ seconds / seconds.sum()),
        "precision": float(right[good] @ seconds[good] / seconds[good].sum()) if good.any() else float("nan"),
        "recall": float(right[good] @ seconds[good] / (right @ seconds)),
    }


def _error(truth: Truth, stretch: Stretch) -> tuple[float, float]:
    carrier = truth.position[:, list(truth.device).index(stretch.device)]
    there = np.column_stack([np.interp(stretch.t, truth.t, carrier[:, axis]) for axis in (0, 1)])
    away = np.hypot(*(stretch.place - there).T)
    known = np.isfinite(away)
    rmse = float(np.sqrt((away[known] ** 2).mean())) if known.any() else float("nan")
    return rmse, float((away < NEAR).mean())
