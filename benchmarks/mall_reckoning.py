"""How far off real legs is dead reckoning, and does it know? Scores of the traces of ``indoor-location``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom, chi2

from benchmarks.mall_traces import NORTH, Trace
from services.gateway.reckoning.dead_reckoning import DeadReckoner, InertialSamples, Walk
from shared.angles import wrap

__all__ = [
    "LONG_LEG",
    "WHOLE",
    "Walked",
    "end_errors",
    "heading_errors",
    "honesty",
    "length_errors",
    "reckon",
    "scores",
]

Array = NDArray[np.float64]

LONG_LEG = 10.0
"""m; headings are judged on legs that are longer, lengths on ``LEG`` and turns between two of those."""
LEG = 5.0
WHOLE = 20.0
"""m; end drift and totals are judged on traces that are at least as long."""
TURN_LATE = 1.2
"""s after a way-point's stamp in which people still turn: left out of headings, never of lengths."""
WAY_POINT_SIGMA = 0.6
"""m, along and across, of a way-point's place at its stamp.

Assumed, not measured: way-points are taps of surveyors on a plan, and no truth says how far off they are. Half a second
between passing and tapping is 0.6 m at 1.2 m/s, and a tap on a plan of a floor this large is hardly surer than that.
How much hangs on it is told by ``WAY_POINT_SIGMAS``.
"""
WAY_POINT_SIGMAS = {"none": 0.0, "30cm": 0.3, "60cm": 0.6}
"""m; the ends' NEES is told for each, by the ending of its name."""

COLUMNS = {"t": "step_t"} | {n: n for n in ("length", "length_variance", "heading", "heading_variance")}
SHARED = {"scale_variance": "length_scale_variance", "bias_variance": "heading_bias_variance"}
"""Fields of ``Motion`` that become the ones of ``Walked``."""


@dataclass(frozen=True, slots=True)
class Walked:
    """The m steps that dead reckoning told of one trace; variances as in ``MotionBatch``.

    Attributes:
        t: (m,) s.
        length: (m,) m.
        length_variance: (m,) m².
        scale_variance: (m,) of the factor common to all lengths, as last told when the step was.
        heading: (m,) radians counter-clockwise from the plan's +x.
        heading_variance: (m,) rad².
        bias_variance: (m,) rad², of what all headings have in common; it shrinks while a phone learns its iron.
    """

    t: Array
    length: Array
    length_variance: Array
    scale_variance: Array
    heading: Array
    heading_variance: Array
    bias_variance: Array

    def own_length_variance(self) -> Array:
        """Return the part of ``length_variance`` that a step does not share, (m,) m²."""
        return np.maximum(self.length_variance - self.length**2 * self.scale_variance, 0.0)

    def own_heading_variance(self) -> Array:
        """Return the part of ``heading_variance`` that a step does not share, (m,) rad²."""
        return np.maximum(self.heading_variance - self.bias_variance, 0.0)


def reckon(traces: Sequence[Trace], reckoner: DeadReckoner | None = None) -> list[Walked]:
    """Return the steps of each trace, as the gateway would tell them of a phone in the hand."""
    reckoner = reckoner or DeadReckoner(NORTH)
    walks = [Walk("hand") for _ in traces]
    samples = [InertialSamples(one.t, one.acceleration, one.rotation, one.field) for one in traces]
    told = [a + b for a, b in zip(reckoner.advance(walks, samples), reckoner.finish(walks), strict=True)]
    found = []
    for motions in told:
        columns = {
            name: np.concatenate([np.empty(0), *(getattr(motion, field) for motion in motions)])
            for name, field in COLUMNS.items()
        }
        shared = {
            name: np.concatenate(
                [np.empty(0), *(np.full(len(motion.step_t), getattr(motion, field)) for motion in motions)]
            )
            for name, field in SHARED.items()
        }
        found.append(Walked(**columns, **shared))
    return found


def on_legs(trace: Trace, t: Array, late: float = 0.0) -> NDArray[np.bool_]:
    """Return which of m steps belong to which of k legs, (k, m): those that ended on it, ``late`` s after its begin."""
    legs = trace.legs()
    return (t > legs.begin[:, None] + late) & (t <= legs.end[:, None])


def length_errors(trace: Trace, walked: Walked) -> Array:
    """Return the relative errors of the legs' lengths, (k,); NaN for those of ``LEG`` or less."""
    true = trace.legs().length
    error: Array = np.where(true > LEG, on_legs(trace, walked.t) @ walked.length / true - 1.0, np.nan)
    return error


def heading_errors(trace: Trace, walked: Walked, longer: float = LONG_LEG) -> Array:
    """Return the errors of the legs' mean headings, (k,) rad; NaN for legs not ``longer`` m or of under two steps."""
    on, legs = on_legs(trace, walked.t, TURN_LATE), trace.legs()
    mean = np.arctan2(on @ np.sin(walked.heading), on @ np.cos(walked.heading))
    judged = (legs.length > longer) & (on.sum(axis=1) >= 2)
    return np.where(judged, wrap(mean - legs.heading), np.nan)


def end_errors(trace: Trace, walked: Walked, way_point_sigma: float = WAY_POINT_SIGMA) -> tuple[Array, Array]:
    """Return by how much the last way-point is missed, (2,) m, and the covariance that was predicted, (2, 2) m².

    The truth's own doubt is part of it, ``way_point_sigma`` m at either end.
    """
    on = (walked.t > trace.way[0, 0]) & (walked.t <= trace.way[-1, 0])
    length, heading = walked.length[on], walked.heading[on]
    along = np.stack([np.cos(heading), np.sin(heading)])
    aside = np.stack([-along[1], along[0]])
    error: Array = along @ length - (trace.way[-1, 1:] - trace.way[0, 1:])
    scaled = along @ (length * np.sqrt(walked.scale_variance[on]))
    turned = aside @ (length * np.sqrt(walked.bias_variance[on]))
    own_length = walked.own_length_variance()[on]
    own_heading = walked.own_heading_variance()[on] * length**2
    covariance = (
        np.outer(scaled, scaled)
        + np.outer(turned, turned)
        + (along * own_length) @ along.T
        + (aside * own_heading) @ aside.T
        + 2.0 * way_point_sigma**2 * np.eye(2)
    )
    return error, covariance


def scores(traces: Sequence[Trace], walked: Sequence[Walked]) -> dict[str, float]:
    """Return medians and ninth deciles of the errors of legs, turns, totals and ends."""
    pairs = list(zip(traces, walked, strict=True))
    length = np.abs(_kept(np.concatenate([length_errors(*pair) for pair in pairs])))
    heading = np.degrees(np.abs(_kept(np.concatenate([heading_errors(*pair) for pair in pairs]))))
    turns = [np.diff(heading_errors(*pair, longer=LEG)) for pair in pairs]
    turn = np.degrees(np.abs(wrap(_kept(np.concatenate(turns)))))
    whole = [pair for pair in pairs if pair[0].legs().length.sum() >= WHOLE]
    total = np.array([_total(*pair) for pair in whole])
    drift = np.array([np.hypot(*end_errors(*pair)[0]) / pair[0].legs().length.sum() for pair in whole])
    return {
        "leg_error": float(np.median(length)),
        "leg_error_p90": float(np.quantile(length, 0.9)),
        "trace_total_error": float(np.median(np.abs(total))),
        "heading_error_deg": float(np.median(heading)),
        "heading_error_p90_deg": float(np.quantile(heading, 0.9)),
        "turn_error_deg": float(np.median(turn)),
        "end_drift": float(np.median(drift)),
        "end_drift_p90": float(np.quantile(drift, 0.9)),
    }


def honesty(traces: Sequence[Trace], walked: Sequence[Walked]) -> dict[str, float]:
    """Return how errors compare with what was predicted for them: shares within one and two σ, and the ends' mean NEES.

    Normal errors lie within one σ in 0.68 and within two in 0.95 of the cases, and n independent ones between
    ``…_low`` and ``…_high`` in 95 of 100 data sets; a mean NEES (normalised estimation error squared) of n
    two-dimensional errors between ``end_nees_low`` and ``end_nees_high``.
    """
    pairs = list(zip(traces, walked, strict=True))
    length = np.abs(_kept(np.concatenate([_normal_lengths(*pair) for pair in pairs])))
    heading = np.abs(_kept(np.concatenate([_normal_headings(*pair) for pair in pairs])))
    whole = [pair for pair in pairs if pair[0].legs().length.sum() >= WHOLE]
    nees = _nees([end_errors(*pair) for pair in whole])
    low, high = (float(chi2.ppf(share, 2 * len(nees))) / len(nees) for share in (0.025, 0.975))
    figures: dict[str, float] = {}
    for name, size in {"leg": length, "heading": heading}.items():
        for sigmas in (1, 2):
            figures[f"{name}_within_{sigmas}_sigma"] = float(np.mean(size < sigmas))
            for end, share in (("low", 0.025), ("high", 0.975)):
                inside = float(binom.ppf(share, len(size), chi2.cdf(sigmas**2, 1)))
                figures[f"{name}_within_{sigmas}_sigma_{end}"] = inside / len(size)
    other_nees = {
        f"end_nees_way_point_{name}": float(_nees([end_errors(*pair, sigma) for pair in whole]).mean())
        for name, sigma in WAY_POINT_SIGMAS.items()
    }
    return {
        **figures,
        "end_nees": float(nees.mean()),
        "end_nees_low": low,
        "end_nees_high": high,
        "end_within_95": float(np.mean(nees < chi2.ppf(0.95, 2))),
        **other_nees,
    }


def _nees(ends: Sequence[tuple[Array, Array]]) -> Array:
    """Return the normalised squares of errors, given with their covariances."""
    return np.array([error @ np.linalg.solve(covariance, error) for error, covariance in ends])


def _normal_lengths(trace: Trace, walked: Walked) -> Array:
    on, true = on_legs(trace, walked.t), trace.legs().length
    found = on @ walked.length
    scaled = on @ (walked.length * np.sqrt(walked.scale_variance))
    variance = scaled**2 + on @ walked.own_length_variance() + 2.0 * WAY_POINT_SIGMA**2
    return np.where(true > LEG, (found - true) / np.sqrt(variance), np.nan)


def _normal_headings(trace: Trace, walked: Walked) -> Array:
    on, true = on_legs(trace, walked.t, TURN_LATE), trace.legs().length
    steps = np.maximum(on.sum(axis=1), 1)
    own = on @ walked.own_heading_variance() / steps**2 + (on @ np.sqrt(walked.bias_variance) / steps) ** 2
    truth = 2.0 * (WAY_POINT_SIGMA / np.maximum(true, LEG)) ** 2
    normal: Array = heading_errors(trace, walked) / np.sqrt(own + truth)
    return normal


def _total(trace: Trace, walked: Walked) -> float:
    inside = (walked.t > trace.way[0, 0]) & (walked.t <= trace.way[-1, 0])
    return float(walked.length[inside].sum() / trace.legs().length.sum() - 1.0)


def _kept(values: Array) -> Array:
    return values[np.isfinite(values)]
