"""Which detector options suit this camera's place? Those whose tracks score best on the last minutes.

After [ravel-thesis §8.2]: sweep the learning rate, re-run detector and tracker on stored pictures for each value, take
the value with the largest cumulative quality score. Here the sweep is coarse, then fine around the best; the curve is
noisy, so a parabola in the logarithm is laid through its top, and what is active stays unless another value is better
by more than the points scatter about a smooth curve, and than the score of both told apart minute by minute may be off.
A second option is then swept about the winner, and the sizes of people that the camera measured are tried with it. Each
of these is held against the winner so far, not against what was active at first: nothing rides on another's gain.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from services.learning.cameras.size_words import size_words
from services.learning.proposal import Proposal
from shared.messages import DetectorSettings
from shared.size_options import SIZE_OPTIONS

__all__ = ["Curve", "DetectorChoice", "Sweep", "choose_detector"]

Array = NDArray[np.float64]
F = TypeVar("F")
Options = tuple[tuple[str, float], ...]

RATES = tuple(float(rate) for rate in np.geomspace(1e-3, 1.0, 8))
"""Learning rates per second that are tried first: [ravel-thesis §8.2] tries 8 to 12 values."""
SENSITIVITIES = (0.5, 0.7, 1.4, 2.0)
"""Factors of the active sensitivity that are tried at the best rate."""
FINE = 4
"""Further values tried around the best of a first sweep."""
TOP = 5
"""Points nearest to the best through which the parabola is laid."""
WIDTH = 1.5
"""Of the smoothing, mean distances between values."""
SURE = 3.0
"""Standard errors by which a gain must be more than chance: the best of a dozen is always lucky."""
CONFIRMED = 2.0
"""Standard errors by which the chosen value itself must score better than the active one."""
LEAST_GAIN = 0.02
"""Share of the active score that a gain must be at least: what is less is not worth a change."""


@dataclass(frozen=True)
class Sweep:
    """One option to be swept, the others as found so far.

    Attributes:
        option: its name.
        values: tried first; of ``relative`` ones, factors of the active value.
        relative: see above.
        least: no smaller value is tried.
        most: nor a larger one.
    """

    option: str
    values: Sequence[float]
    relative: bool = False
    least: float = 0.0
    most: float = math.inf


SWEEPS = (
    Sweep("learning_rate", RATES, least=1e-4, most=10.0),
    Sweep("sensitivity", SENSITIVITIES, relative=True, least=4.0, most=200.0),
)


@dataclass(frozen=True)
class Curve:
    """Scores of one option's values.

    Attributes:
        option: its name.
        value: (n,) ascending.
        score: (n,) of each.
        active: the active value, one of ``value``.
        best: where the smoothed curve has its top.
        gain: by how much the smoothed curve is higher there than at ``active``.
        error: standard error of that gain, from how the points scatter about the smooth curve.
    """

    option: str
    value: Array
    score: Array
    active: float
    best: float
    gain: float
    error: float


@dataclass(frozen=True)
class DetectorChoice:
    """What a sweep found.

    Attributes:
        options: those to be changed, with their new values; empty where the active ones are good enough.
        gain: score of the new options less that of the active ones.
        margin: what it had to be.
        curves: of each option that was swept.
        refused: why nothing could be said, in plain words; empty otherwise.
        sizes: how people were measured to look, where that was tried.
        sized: scores of that and of the sizes in use.
    """

    options: Mapping[str, float] = field(default_factory=dict)
    gain: float = 0.0
    margin: float = 0.0
    curves: Sequence[Curve] = ()
    refused: str = ""
    sizes: Mapping[str, float] = field(default_factory=dict)
    sized: Mapping[str, float] = field(default_factory=dict)

    def proposal(self, camera: str, area: str, trained_until: float, active: Mapping[str, float]) -> Proposal | None:
        """Return the proposal for activation; None where nothing is to be changed.

        Args:
            camera: whose detector.
            area: whose tracks were scored.
            trained_until: time of the newest picture, seconds since the epoch.
            active: the learned options now in use, which those not swept keep.
        """
        if not self.options:
            return None
        evidence = {
            f"score at {curve.option} {value:.4g}": score
            for curve in self.curves
            for value, score in zip(curve.value.tolist(), curve.score.tolist(), strict=True)
        }
        changes = [
            f"{curve.option} {curve.active:.3g} → {self.options[curve.option]:.3g}"
            for curve in self.curves
            if curve.option in self.options
        ]
        evidence |= {f"score with sizes {name}": score for name, score in self.sized.items()}
        sizes = {name: value for name, value in self.options.items() if name in SIZE_OPTIONS}
        if sizes:
            changes.append(f"the sizes people were seen to have: {size_words(sizes)}")
        options = {**active, **self.options}
        reason = f"people are followed better on the last minutes' pictures with {', '.join(changes)}"
        return Proposal(
            kind="detector",
            subject=camera,
            area=area,
            model=DetectorSettings(t=trained_until, camera=camera, version=0, options=options, reason=reason),
            trained_until=trained_until,
            gain=self.gain,
            margin=self.margin,
            evidence=evidence,
            reason=reason,
        )


def choose_detector(
    active: Mapping[str, float],
    redetect: Callable[[Mapping[str, float]], F | None],
    score: Callable[[F, F], Mapping[str, float] | None],
    sweeps: Sequence[Sweep] = SWEEPS,
    sizes: Mapping[str, float] | None = None,
) -> DetectorChoice:
    """Return the options that score best.

    Every candidate, the active options too, must be detected on the same pictures.

    Args:
        active: the value in use of every option that is swept.
        redetect: options → what the camera would have detected; None: they cannot be tried, and are left out.
        score: detections, those of the best options so far → ``cqs``, the cumulative quality score of the tracks that
            the first make (or another score that grows with how well people are followed), and ``error`` where it is
            known: the standard error of that score less the second's. None: it cannot be told.
        sweeps: what is swept, in this order.
        sizes: how tall and wide people were measured to be, as options, to be tried with the best of the others.

    Raises:
        ValueError: an active value is missing or not positive.
    """
    for sweep in sweeps:
        if not active.get(sweep.option, 0.0) > 0.0:
            raise ValueError(
                f"active.{sweep.option}: found {active.get(sweep.option)}; allowed: the value in use, above 0"
            )

    @lru_cache(maxsize=1)  # minutes of everybody's detections: those of one trial at a time, and of the best so far
    def detected(key: Options) -> F | None:
        return redetect(dict(key))

    current = {sweep.option: active[sweep.option] for sweep in sweeps}
    best = detected(_key(current))
    errors: dict[Options, float] = {}
    scores: dict[Options, float | None] = {}

    def tried(options: Mapping[str, float]) -> float | None:
        key = _key(options)
        if key not in scores:
            detections = detected(key)
            told = None if detections is None or best is None else score(detections, best)
            known = told is not None and math.isfinite(told["cqs"])
            scores[key] = told["cqs"] if told is not None and known else None
            errors[key] = told.get("error", 0.0) if told is not None else 0.0
        return scores[key]

    begin = tried(current)
    if begin is None:
        return DetectorChoice(refused="the active options could not be scored on the camera's pictures")
    curves: list[Curve] = []
    changed: dict[str, float] = {}
    gain, error = 0.0, 0.0
    least = LEAST_GAIN * abs(begin)
    for sweep in sweeps:
        curve = _swept(sweep, current, tried)
        if curve is None:
            continue
        curves.append(curve)
        if curve.gain <= max(SURE * curve.error, least):
            continue
        wanted = {**current, sweep.option: curve.best}
        told, apart = tried(wanted), errors[_key(wanted)]
        if told is None or told - begin - gain <= CONFIRMED * apart or (winner := detected(_key(wanted))) is None:
            continue
        current, best, gain, error = wanted, winner, told - begin, error + apart
        changed[sweep.option] = curve.best
    sized: dict[str, float] = {}
    sizes = sizes or {}
    if sizes:
        wanted = {**current, **sizes}
        told, apart = tried(wanted), errors[_key(wanted)]
        if told is not None:
            sized = {"in use": begin + gain, "measured": told}
            if told - begin - gain > max(CONFIRMED * apart, least):
                gain, error = told - begin, error + apart
                changed |= sizes
    return DetectorChoice(
        changed, gain, max(CONFIRMED * error, least), curves, sizes=sizes if sized else {}, sized=sized
    )


def _key(options: Mapping[str, float]) -> Options:
    return tuple(sorted(options.items()))


def _swept(
    sweep: Sweep, current: Mapping[str, float], tried: Callable[[Mapping[str, float]], float | None]
) -> Curve | None:
    """Return the curve of one option, None where too few of its values could be scored."""
    active = current[sweep.option]
    known: dict[float, float] = {}

    def look(value: float) -> None:
        value = min(max(value, sweep.least), sweep.most)
        if not any(abs(math.log(value / other)) < 1e-6 for other in known):
            told = tried({**current, sweep.option: value})
            if told is not None:
                known[value] = told

    look(active)
    for value in sweep.values:
        look(active * value if sweep.relative else value)
    if len(known) >= 3:
        values = sorted(known)
        top = max(known, key=lambda value: known[value])
        place = values.index(top)
        for low, high in ((place - 1, place), (place, place + 1)):
            if low >= 0 and high < len(values):
                ratio = values[high] / values[low]
                for share in np.arange(1, FINE // 2 + 1) / (FINE // 2 + 1):
                    look(values[low] * ratio ** float(share))
    if len(known) < 3:
        return None
    values = sorted(known)
    return _topped(sweep.option, np.array(values), np.array([known[value] for value in values]), active)


def _topped(option: str, value: Array, score: Array, active: float) -> Curve:
    """Lay the parabola through the top of the curve, and read what is gained from the smooth curve."""
    x = np.log(value)
    smoother = _smoother(x)
    smooth = smoother @ score
    freedom = max(float((1.0 - np.diag(smoother)).sum()), 1.0)
    scatter = math.sqrt(float(((score - smooth) ** 2).sum()) / freedom)
    peak, now = int(np.argmax(smooth)), int(np.argmin(np.abs(x - math.log(active))))
    best = float(x[peak])
    near = np.argsort(np.abs(x - best), kind="stable")[:TOP]
    if len(near) >= 4:
        a, b, _ = np.polyfit(x[near] - best, score[near], 2)
        if a < 0.0:
            best = float(np.clip(best - 0.5 * b / a, x[near].min(), x[near].max()))
    error = scatter * float(np.linalg.norm(smoother[peak] - smoother[now]))
    return Curve(option, value, score, active, float(f"{math.exp(best):.3g}"), float(smooth[peak] - smooth[now]), error)


def _smoother(x: Array) -> Array:
    """Return the matrix (n, n) that turns scores at ``x`` into a smooth curve: local parabolas."""
    width = max(WIDTH * float(x[-1] - x[0]) / len(x), 1e-9)
    rows = []
    for centre in x.tolist():
        weight = np.exp(-0.5 * ((x - centre) / width) ** 2)
        design = np.column_stack([np.ones_like(x), x - centre, (x - centre) ** 2])
        weighed = (design * weight[:, None]).T
        rows.append(np.linalg.solve(weighed @ design + 1e-9 * np.eye(3), weighed)[0])
    return np.array(rows)
