"""Which law of step length holds on legs it has not seen? Laws fitted to all traces of ``indoor-location`` but one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.mall_reckoning import LEG, WHOLE, Walked, on_legs
from benchmarks.mall_traces import Trace
from services.gateway.reckoning.bounce import KERNEL
from services.gateway.reckoning.hops import RATE
from shared.walking.stride import BELIEF, CADENCES, LENGTHS, USUAL_BOUNCE, USUAL_CADENCE
from shared.walking.stride_learning import fit_line

__all__ = ["LAWS", "Gait", "Law", "gait", "held_out", "personal"]

Array = NDArray[np.float64]

SECOND = 0.2, 1.4
"""Seconds between which a step follows the one before it."""


@dataclass(frozen=True, slots=True)
class Gait:
    """Cadence (m,) steps/s and bounce (m,) m/s² of the m steps of one trace."""

    cadence: Array
    bounce: Array


@dataclass(frozen=True, slots=True)
class Law:
    """A law of step length, linear in what is fitted.

    Attributes:
        columns: of the m steps, (m, k); the first is what the fit adjusts the level with.
        given: (k,) what is not fitted but known; None where all is fitted.
        belief: share of the fitted slopes that is believed; the level is then fitted again.
    """

    columns: Callable[[Gait], Array]
    given: tuple[float, ...] | None = None
    belief: float = 1.0


def _with_bounce(gait: Gait) -> Array:
    bounced = gait.bounce**0.25 - USUAL_BOUNCE**0.25
    return np.column_stack([np.ones(len(bounced)), np.clip(gait.cadence, *CADENCES) - USUAL_CADENCE, bounced])


def _pendulum(gait: Gait) -> Array:
    return np.column_stack([np.sqrt(gait.bounce) / np.clip(gait.cadence, *CADENCES), np.ones(len(gait.bounce))])


def _line(gait: Gait) -> Array:
    return np.column_stack([np.ones(len(gait.cadence)), gait.cadence - USUAL_CADENCE])


LAWS = {
    "universal": Law(_with_bounce, belief=BELIEF),
    "constant": Law(_line, given=(0.70, 0.0)),
    "thesis_line": Law(_line, given=(0.35 * USUAL_CADENCE + 0.20, 0.35)),
    "cadence": Law(_line),
    "bounce_fully": Law(_with_bounce),
    "pendulum": Law(_pendulum),
}
"""``universal`` has the form that ships."""


def gait(trace: Trace, t: Array) -> Gait:
    """Return cadence and bounce of the steps at ``t`` (m,) s of a trace, as the gateway measures them."""
    even = np.arange(trace.t[0], trace.t[-1], 1.0 / RATE)
    norm = np.interp(even, trace.t, np.linalg.norm(trace.acceleration, axis=1))
    reach = len(KERNEL) // 2
    middle = np.rint((t - even[0]) * RATE).astype(np.int64)
    window = np.clip(middle[:, None] + np.arange(-reach, reach + 1), 0, len(even) - 1)
    interval = np.diff(t, prepend=np.nan)
    follows = (interval > SECOND[0]) & (interval < SECOND[1])
    usual = np.median(interval[follows]) if follows.any() else 1.0 / USUAL_CADENCE
    return Gait(1.0 / np.where(follows, interval, usual), 4.0 * np.abs(norm[window] @ KERNEL))


def held_out(
    law: Law, traces: Sequence[Trace], walked: Sequence[Walked], gaits: Sequence[Gait]
) -> tuple[list[Walked], Array]:
    """Return the walks with lengths by a law fitted to all traces but each, and the fit to all of them, (k,)."""
    rows = [_legs(law, *each) for each in zip(traces, walked, gaits, strict=True)]
    told = []
    for number, (one, its) in enumerate(zip(walked, gaits, strict=True)):
        others = [row for place, row in enumerate(rows) if place != number]
        told.append(_relengthened(one, np.clip(law.columns(its) @ _fit(law, others), *LENGTHS)))
    return told, _fit(law, rows)


def personal(traces: Sequence[Trace], walked: Sequence[Walked], gaits: Sequence[Gait]) -> dict[str, float]:
    """Return the median error on the second halves of traces, of three models.

    The universal one, whose lengths ``walked`` has and which must not have seen the trace; a plain line through the
    steps of the first half; the line with the prior of ``fit_line`` through them.
    """
    errors: dict[str, list[float]] = {"universal": [], "plain": [], "prior": []}
    for trace, one, its in zip(traces, walked, gaits, strict=True):
        true, on = trace.legs().length, on_legs(trace, one.t)
        first = np.cumsum(true) <= 0.5 * true.sum()
        teach = on[first & (true > LEG)].T
        if true.sum() < WHOLE or teach.sum() < 10 or not on[~first].any():
            continue
        which = teach.any(axis=1)
        length = (teach @ (true[first & (true > LEG)] / np.maximum(teach.sum(axis=0), 1)))[which]
        slope, level = np.polyfit(its.cadence[which], length, 1)
        line = fit_line(its.cadence[which], length)
        judged = {
            "universal": one.length,
            "plain": np.clip(slope * its.cadence + level, *LENGTHS),
            "prior": np.clip(line.slope * its.cadence + line.offset, *LENGTHS),
        }
        for name, lengths in judged.items():
            errors[name].append(abs(float((on[~first] @ lengths).sum() / true[~first].sum()) - 1.0))
    return {f"second_half_{name}": float(np.median(each)) for name, each in errors.items()}


def _legs(law: Law, trace: Trace, walked: Walked, its: Gait) -> tuple[Array, Array]:
    """Return the sums of the law's columns over each leg (l, k), and the legs' lengths (l,) m."""
    true = trace.legs().length
    return (on_legs(trace, walked.t) @ law.columns(its))[true > LEG], true[true > LEG]


def _fit(law: Law, legs: Sequence[tuple[Array, Array]]) -> Array:
    """Return the coefficients (k,) with the least mean relative error."""
    if law.given is not None:
        return np.array(law.given)
    x, y = (np.concatenate([leg[part] for leg in legs]) for part in (0, 1))
    found = _least_deviations(x, y, y)
    if law.belief != 1.0:
        found[1:] *= law.belief
        found[:1] = _least_deviations(x[:, :1], y - x[:, 1:] @ found[1:], y)
    return found


def _least_deviations(x: Array, y: Array, scale: Array) -> Array:
    """Return the coefficients with the least sum of |x b - y| / scale, by reweighted least squares."""
    weight = 1.0 / scale
    found = np.zeros(x.shape[1])
    for _ in range(25):
        found = np.asarray(np.linalg.lstsq(x * weight[:, None], y * weight, rcond=None)[0], np.float64)
        weight = 1.0 / (scale * np.sqrt(np.maximum(np.abs(x @ found - y) / scale, 0.01)))
    return found


def _relengthened(walked: Walked, length: Array) -> Walked:
    """Return the walk with other lengths, as sure of them as of the old ones."""
    return replace(walked, length=length, length_variance=walked.length_variance * (length / walked.length) ** 2)
