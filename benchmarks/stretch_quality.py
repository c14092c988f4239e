"""Does quality tell good stretches from bad ones? Judged stretches of a record beside the truth, and with lies added.

What learning sees of a run: detections, radio, steps, track frames and revisions, in the order of the bus.
"""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from benchmarks.fusion_run import FusionRun
from benchmarks.revised import said_later
from benchmarks.world_record import Truth, WorldRecord
from services.learning.tracks.assembler import StretchAssembler
from services.learning.tracks.compare import compare
from services.learning.tracks.quality import QualityJudge
from services.learning.tracks.sight import SightScore
from services.learning.tracks.stretch import Stretch
from services.learning.tracks.verdict import Verdict
from shared.messages import DetectionFrame, RadioScan
from shared.radio import PathLoss
from shared.site import camera_views

__all__ = [
    "DeviceMinutes",
    "Judged",
    "agreement",
    "device_minutes",
    "judged",
    "radio_of_area",
    "stretches_of",
    "with_swapped_radio",
]

Array = NDArray[np.float64]

NEAR = 1.0
"""Metres from the carrier within which a name is right."""
LEAST_TOLD = 0.5
"""Share of a minute for which a device must be told to be somewhere."""
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


@dataclass(frozen=True)
class DeviceMinutes:
    """What was told of devices, a minute at a time, wrong names and times without a camera among it: (k,) each.

    Attributes:
        seconds: of the minute for which the device was told to be somewhere.
        sight: nats by which cameras spoke for the tracks that bore its name; a second on none counts as missed.
        radio: nats by which its readings fit the way it was told to go, against no places.
        walk: nats by which its steps do.
        named: share of the seconds in which it was told on a track.
        rmse: metres from its carrier, root mean square.
    """

    seconds: Array
    sight: Array
    radio: Array
    walk: Array
    named: Array
    rmse: Array

    @property
    def printed(self) -> Array:
        """Q of [ravel-thesis §8.1, Eq. 5.1], of the device as the filter follows it."""
        return self.sight + self.radio + self.walk


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


def device_minutes(record: WorldRecord, run: FusionRun, minute: float = 60.0) -> DeviceMinutes:
    """Return what was told of each device in each minute of a run, how good it looks and how right it was.

    The study's Fig. 5.4 scores what its filter follows, and that is the device, not a track: cameras' part is the
    track's that bears the name then, log(1 - p_d) a second where none does, and radio and steps are held against the
    way told. Minutes with less than ``LEAST_TOLD`` of telling are left out.
    """
    truth, radio = record.truth, radio_of_area(record)
    devices = [device for device in truth.device if device is not None]
    t = np.arange(run.frames[0].t, run.frames[-1].t, 1.0)
    said = said_later(t, devices, run.frames, run.revisions)
    sight, detected = _sight_by_second(record, run, t)
    missed = math.log(1.0 - detected)
    judge, stretches = QualityJudge(len(radio.names)), iter(stretches_of(record, run))
    stretch = next(stretches, None)
    phones = {device: _Phone.of(record, device) for device in devices}
    rows = []
    for begin in np.arange(t[0], t[-1] - minute + 1.0, minute):
        while stretch is not None and stretch.t[-1] <= begin:
            judge.judge(stretch, radio)
            stretch = next(stretches, None)
        during = np.flatnonzero((t >= begin) & (t < begin + minute))
        for number, device in enumerate(devices):
            told = during[np.isfinite(said.position[during, number, 0])]
            carrier = truth.position[:, list(truth.device).index(device)]
            away = np.hypot(*(said.position[told, number] - _at(truth.t, carrier, t[told])).T)
            told, away = told[np.isfinite(away)], away[np.isfinite(away)]
            if len(told) < LEAST_TOLD * minute:
                continue
            track = said.track[told, number]
            nats = sum(
                sight.get((int(one), int(at)), 0.0) if one > 0 else missed for one, at in zip(track, told, strict=True)
            )
            compared = compare(
                phones[device].along(device, t[told], said.position[told, number]), radio, None, judge.belief(device)
            )
            rows.append(
                (
                    float(len(told)),
                    nats,
                    compared.radio[0],
                    compared.walk[0],
                    (track > 0).mean(),
                    np.sqrt((away**2).mean()),
                )
            )
    return DeviceMinutes(*np.array(rows).reshape(-1, 6).T)


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


def _sight_by_second(record: WorldRecord, run: FusionRun, t: Array) -> tuple[dict[tuple[int, int], float], float]:
    """Return the nats cameras spoke for each track up to each of (n,) seconds, and how much of people they see."""
    sight, nats = SightScore(camera_views(record.site, record.area).each), defaultdict[tuple[int, int], float](float)
    detections = iter([(t, message) for t, message in record.arrivals if isinstance(message, DetectionFrame)])
    arrival = next(detections, None)
    for frame in run.frames:
        while arrival is not None and arrival[0] <= frame.t + BUS:
            sight.take_detections(arrival[1])
            arrival = next(detections, None)
        second = int(np.searchsorted(t, frame.t))
        for track, gain in sight.score(frame).items():
            nats[track, second] += gain
    return nats, float(np.mean(list(sight.detected().values())))


@dataclass(frozen=True)
class _Phone:
    """What a phone said, in order of time: readings (r, 3), steps (s, 6), times it stood (b, 2)."""

    readings: Array
    steps: Array
    still: Array

    @classmethod
    def of(cls, record: WorldRecord, device: str) -> _Phone:
        column = {name: number for number, name in enumerate(radio_of_area(record).names)}
        readings = [
            (scan.t, column[name], level)
            for scan in record.scans[device]
            for name, level in zip(scan.access_point, scan.rssi, strict=True)
            if name in column
        ]
        steps: list[tuple[float, ...]] = []
        still: list[tuple[float, float]] = []
        for batch in record.motions[device]:
            since = math.inf if batch.revises_from is None else batch.revises_from
            steps = [row for row in steps if row[0] < since]
            still = [row for row in still if row[0] < since]
            columns = (batch.step_t, batch.length, batch.length_variance, batch.heading, batch.heading_variance)
            steps += [(*row, batch.walk) for row in zip(*columns, strict=True)]
            if batch.activity == "still" and not batch.step_t:
                still.append((batch.t_start, batch.t))
        return cls(_table(readings, 3), _table(steps, 6), _table(still, 2))

    def along(self, device: str, t: Array, place: Array) -> Stretch:
        """Return the phone on a way (n, 2), with nobody else about."""
        readings, steps, still = (
            rows[(rows[:, 0] >= t[0]) & (rows[:, 0] <= t[-1])] for rows in (self.readings, self.steps, self.still)
        )
        nothing = np.zeros(len(t))
        return Stretch(
            device=device,
            track=0,
            t=t,
            place=place,
            covariance=np.zeros((len(t), 2, 2)),
            probability=nothing,
            seen=np.ones(len(t), np.bool_),
            sight=nothing,
            scan_t=readings[:, 0],
            point=readings[:, 1].astype(np.int64),
            level=readings[:, 2],
            scan_place=_at(t, place, readings[:, 0]),
            scan_spread=np.zeros(len(readings)),
            step_t=steps[:, 0],
            length=steps[:, 1],
            length_variance=steps[:, 2],
            heading=steps[:, 3],
            heading_variance=steps[:, 4],
            walk=steps[:, 5].astype(np.int64),
            still=still,
        )


def _table(rows: Sequence[tuple[float, ...]], columns: int) -> Array:
    return np.array(sorted(rows), float).reshape(-1, columns)


def _at(known: Array, place: Array, t: Array) -> Array:
    return np.column_stack([np.interp(t, known, place[:, axis]) for axis in (0, 1)])


def _error(truth: Truth, stretch: Stretch) -> tuple[float, float]:
    carrier = truth.position[:, list(truth.device).index(stretch.device)]
    there = np.column_stack([np.interp(stretch.t, truth.t, carrier[:, axis]) for axis in (0, 1)])
    away = np.hypot(*(stretch.place - there).T)
    known = np.isfinite(away)
    rmse = float(np.sqrt((away[known] ** 2).mean())) if known.any() else float("nan")
    return rmse, float((away < NEAR).mean())
