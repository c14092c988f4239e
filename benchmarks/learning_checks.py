"""How near do learned models come to what the truth could have taught? Truth scores here, it never teaches."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from benchmarks.fusion_run import FusionRun
from benchmarks.world_record import Truth, WorldRecord
from services.fusion.area_view import AreaView
from services.learning.tracks.stretch import Stretch
from shared.messages import TrackFrame
from shared.walking.stride import StrideLine, step_lengths

__all__ = ["radio_residual", "stretch_rmse", "stride_errors", "true_run"]

Array = NDArray[np.float64]

EVERY = 2
"""Of the truth's times one becomes a frame."""
SURE = (0.01, 0.0, 0.01)
"""m²: of the truth."""
STEP = 0.35, 1.0
"""Seconds between which a step follows the one before."""
RUN, LEAST_WAY = 6, 1.5
"""Steps of a run, and metres: who goes less far in so many treads on the spot."""
FEWEST = 60
"""Steps of a test part without which nobody's stride is judged."""


def true_run(record: WorldRecord) -> FusionRun:
    """Return what a perfect tracker would have published: everybody in view, with the right names."""
    truth = record.truth
    frames = []
    for row in range(0, len(truth.t), EVERY):
        there = np.flatnonzero(truth.in_view[row] & np.isfinite(truth.position[row]).all(axis=1)).tolist()
        count = len(there)
        frames.append(
            TrackFrame(
                t=float(truth.t[row]),
                area=record.area,
                chunk=row,
                tracker="truth",
                track=[person + 1 for person in there],
                floor=[record.site.area(record.area).floor] * count,
                x=[float(truth.position[row, person, 0]) for person in there],
                y=[float(truth.position[row, person, 1]) for person in there],
                covariance=[SURE] * count,
                vx=[0.0] * count,
                vy=[0.0] * count,
                state=["confirmed"] * count,
                device=[truth.device[person] for person in there],
                probability=[0.99] * count,
                runner_up=[None] * count,
                runner_up_probability=[0.0] * count,
                former=[[]] * count,
                sources=[[]] * count,
                quality=[1.0] * count,
            )
        )
    return FusionRun(frames, [], [0.0] * len(frames))


def radio_residual(record: WorldRecord, view: AreaView) -> Array:
    """Return heard minus foretold, dB, of all readings of carriers in view at their true places.

    What a phone reads too much on average is taken off first: no model of a place knows it.
    """
    truth = record.truth
    column = {name: number for number, name in enumerate(view.radio.names)}
    off: list[Array] = []
    for person in truth.carriers():
        device = truth.device[person]
        rows = [
            (scan.t, level, column[name])
            for scan in record.scans.get(device or "", ())
            for name, level in zip(scan.access_point, scan.rssi, strict=True)
            if name in column
        ]
        if not rows or not len(truth.t):
            continue
        t, level, point = np.array(rows, float).T
        at = np.clip(np.searchsorted(truth.t, t), 0, len(truth.t) - 1)
        place = truth.position[at, person]
        seen = truth.in_view[at, person] & np.isfinite(place).all(axis=1)
        if not seen.any():
            continue
        place, point = place[seen], point[seen].astype(np.int64)
        foretold = view.radio.rssi(place)
        if view.shadowing is not None:
            foretold = foretold + view.shadowing.at(place)[0]
        residual = level[seen] - foretold[np.arange(len(place)), point]
        off.append(residual - residual.mean())
    return np.concatenate(off) if off else np.zeros(0)


def stride_errors(record: WorldRecord, lines: Mapping[str, StrideLine], fewest: int = FEWEST) -> Array:
    """Return (d, 2): by which share each device's line is wrong about the way its carrier truly went.

    First where they walk: in runs of ``RUN`` steps that led on. Then over all steps, also the half ones at the ends of
    walks and those on the spot, of which no line of length on cadence knows.
    """
    truth = record.truth
    errors = []
    for person in truth.carriers():
        line = lines.get(truth.device[person] or "")
        if line is None:
            continue
        t, walk = _steps(record, truth, person)
        interval = np.diff(t)
        place = np.column_stack([np.interp(t, truth.t, truth.position[:, person, axis]) for axis in (0, 1)])
        went = np.linalg.norm(np.diff(place, axis=0), axis=1)
        fine = (np.diff(walk) == 0) & (interval >= STEP[0]) & (interval <= STEP[1]) & np.isfinite(went)
        runs = _runs(fine)
        runs = runs[went[runs].sum(axis=1) >= LEAST_WAY]
        if fine.sum() < fewest or not len(runs):
            continue
        cadence = 1.0 / np.where(fine, interval, 1.0)
        foretold = step_lengths(cadence, np.full(len(cadence), np.nan), line).length
        errors.append([abs(float(foretold[of].sum() / went[of].sum()) - 1.0) for of in (runs, fine)])
    return np.array(errors, float).reshape(-1, 2)


def _runs(fine: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return (m, RUN) numbers of steps that follow each other, one run after the other."""
    first, found = 0, []
    while first + RUN <= len(fine):
        broken = np.flatnonzero(~fine[first : first + RUN])
        if len(broken):
            first += int(broken[-1]) + 1
            continue
        found.append(np.arange(first, first + RUN))
        first += RUN
    return np.array(found, np.int64).reshape(-1, RUN)


def stretch_rmse(stretch: Stretch, truth: Truth) -> float:
    """Return how far the carrier of a stretch's phone truly was from its track, metres; NaN where nobody knows."""
    person = list(truth.device).index(stretch.device)
    at = np.clip(np.searchsorted(truth.t, stretch.t), 0, len(truth.t) - 1)
    off = stretch.place - truth.position[at, person]
    known = np.isfinite(off).all(axis=1)
    return float(np.sqrt((off[known] ** 2).sum(axis=1).mean())) if known.any() else float("nan")


def _steps(record: WorldRecord, truth: Truth, person: int) -> tuple[Array, NDArray[np.int64]]:
    """Return when the steps of a carrier ended, (s,), and of which walk each is."""
    t: list[float] = []
    walk: list[int] = []
    for batch in record.motions.get(truth.device[person] or "", ()):
        if batch.revises_from is not None:
            while t and t[-1] >= batch.revises_from:
                t.pop()
                walk.pop()
        t += batch.step_t
        walk += [batch.walk] * len(batch.step_t)
    return np.array(t), np.array(walk, np.int64)
