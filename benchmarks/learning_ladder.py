"""What does each lesson gain? The study's ladder: as found, + detector, + radio, + stride [ravel-thesis §11.4].

In every split the training part teaches, through the tracks of the tracker that is tested and without truth; then a
fresh tracker of the same kind runs over the test part, with what was learned so far.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.device_minutes import device_minutes
from benchmarks.fusion_run import run_fusion
from benchmarks.learning_adapter import chosen_rate, learned_radio, learned_strides, run_with_score
from benchmarks.learning_checks import radio_residual, stretch_rmse, stride_errors, true_run
from benchmarks.learning_detections import Seen, with_detections
from benchmarks.learning_splits import Split, part_of
from benchmarks.learning_stretches import stretches_of
from benchmarks.learning_strides import with_strides
from benchmarks.position_error import centre_of, window_rmse
from benchmarks.track_reading import named_positions
from benchmarks.world_record import WorldRecord
from services.fusion.area_view import AreaView
from services.fusion.registry import DEFAULT_TRACKER

__all__ = ["RATES", "STAGES", "TRACKERS", "Climb", "RateCurve", "Rung", "climb", "climb_split", "rate_curve"]

Array = NDArray[np.float64]

STAGES = ("none", "detector", "radio", "all")
TRACKERS = {DEFAULT_TRACKER: "", "rbmcda": "_rbmcda"}
"""With the suffix of their figures."""
RATES = (0.002, 0.005, 0.01, 0.02, 0.05, 0.2)
"""Per second, of the cameras' backgrounds; the configured one is among them."""
LOOK_BACK = 300.0
"""Seconds at the end of the training part on which rates are compared: as much as a camera remembers."""
MINUTE = 50.0
"""Seconds of a stretch that is counted among those that may teach or may not, at least."""
FINDING_OUT = 60.0
"""Seconds at their beginning that do not count: who is who is still found out."""


@dataclass(frozen=True)
class RateCurve:
    """How good each rate is, on the end of one training part.

    Attributes:
        score: (r,) of the tracks, nats per second; no truth is in it.
        rmse: (r,) metres, median over people and minutes, for the picture only.
        chosen: place of the rate that learning takes.
    """

    score: Array
    rmse: Array
    chosen: int


@dataclass(frozen=True)
class Rung:
    """What one split gives one tracker.

    Attributes:
        errors: (w,) metres by stage, one per person and minute of the test part.
        learned: (n,) dB, heard minus foretold by the learned radio model at true places of the test part.
        fitted: (n,) dB, the same of a model fitted to the training part's true places.
        strides: (d, 2) share by which each learned stride is wrong in the test part, see ``stride_errors``.
        minutes: (k, 4) of each phone in each minute of the training part, wrong names and times out of view among
            it: quality, nats [ravel-thesis §8.1, Eq. 5.1]; for how long it was told to be somewhere, s; true RMSE, m;
            share of that time in which it was told on a track.
        stretches: (s, 2) of its stretches of about a minute: true RMSE, m; 1 where one may teach, else 0.
    """

    errors: Mapping[str, Array]
    learned: Array
    fitted: Array
    strides: Array
    minutes: Array
    stretches: Array


@dataclass(frozen=True)
class Climb:
    """All splits of one area: a curve for each, and a rung for each by tracker."""

    curves: Sequence[RateCurve]
    rungs: Mapping[str, Sequence[Rung]]


def rate_curve(record: WorldRecord, seen: Sequence[Seen], split: Split, active: float) -> RateCurve:
    """Return how each rate's detections do on the end of the training part of a split; ``active``: the rate in use."""
    begin = max(split.turn - LOOK_BACK, split.start)
    end, judged = part_of(record, begin, split.turn), part_of(record, begin + FINDING_OUT, split.turn)
    view = AreaView.of(record.site, record.area)
    score, rmse = [], []
    for other in seen:
        run, quality = run_with_score(with_detections(end, other), DEFAULT_TRACKER, view)
        errors = window_rmse(judged.truth, named_positions(judged.truth, run.frames), centre_of(record.view)).rmse
        score.append(quality)
        rmse.append(float(np.nanmedian(errors)))
    return RateCurve(np.array(score), np.array(rmse), chosen_rate(RATES, score, active))


def climb(record: WorldRecord, seen: Sequence[Seen], splits: Sequence[Split], active: float) -> Climb:
    """Return the errors of each tracker at each stage over all splits of one area.

    Args:
        record: the whole run as configured.
        seen: what its cameras see with each of ``RATES``.
        splits: of the run.
        active: learning rate with which its cameras were configured.
    """
    curves = [rate_curve(record, seen, split, active) for split in splits]
    rungs: dict[str, list[Rung]] = {tracker: [] for tracker in TRACKERS}
    for curve, split in zip(curves, splits, strict=True):
        other = None if RATES[curve.chosen] == active else seen[curve.chosen]
        for tracker, rung in climb_split(record, other, split).items():
            rungs[tracker].append(rung)
    return Climb(curves, rungs)


def climb_split(record: WorldRecord, seen: Seen | None, split: Split) -> dict[str, Rung]:
    """Return what one split gives each tracker, with detections as its training part chose them; None: as they are."""
    found = AreaView.of(record.site, record.area)
    training, test = part_of(record, split.start, split.turn), part_of(record, split.turn, split.end)
    better = test
    if seen is not None:
        training, better = with_detections(training, seen), with_detections(test, seen)
    perfect = [stretch for stretch, _ in stretches_of(training, true_run(training), found)]
    fitted = radio_residual(test, learned_radio(perfect, record.site, found))
    return {tracker: _rung(training, test, better, tracker, fitted) for tracker in TRACKERS}


def _rung(training: WorldRecord, test: WorldRecord, better: WorldRecord, tracker: str, fitted: Array) -> Rung:
    found = AreaView.of(training.site, training.area)
    run = run_fusion(training, tracker, view=found)
    judged = list(stretches_of(training, run, found))
    good = [stretch for stretch, verdict in judged if verdict.good]
    doubtful = [stretch for stretch, verdict in judged if verdict.doubtful]
    view = learned_radio(good, training.site, found, doubtful)
    strides = learned_strides(good, training.area)
    minutes = device_minutes(training, run)
    stretches = [
        (stretch_rmse(one, training.truth), float(verdict.good)) for one, verdict in judged if one.seconds >= MINUTE
    ]
    stages = {
        "none": (test, found),
        "detector": (better, found),
        "radio": (better, view),
        "all": (with_strides(better, strides), view),
    }
    errors: dict[str, Array] = {}
    before: tuple[WorldRecord, AreaView] | None = None
    for stage, (part, known) in stages.items():
        # Where a stage learned nothing, it is the one before.
        same = before is not None and before[0] is part and before[1] is known
        errors[stage] = list(errors.values())[-1] if same else _errors(part, tracker, known)
        before = part, known
    return Rung(
        errors=errors,
        learned=radio_residual(test, view),
        fitted=fitted,
        strides=stride_errors(test, strides),
        minutes=np.column_stack([minutes.printed, minutes.seconds, minutes.rmse, minutes.named]),
        stretches=np.array(stretches, float).reshape(-1, 2),
    )


def _errors(record: WorldRecord, tracker: str, view: AreaView) -> Array:
    tracks = run_fusion(record, tracker, view=view).frames
    errors = window_rmse(record.truth, named_positions(record.truth, tracks), centre_of(record.view)).rmse
    known: Array = errors[np.isfinite(errors)]
    return known
