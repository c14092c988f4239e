"""How well is the heading of a walker told by a phone in the trouser pocket, beside five other ways to tell it?

Three chains: as the gateway ships it (calibration, complementary filter, gated peaks) on the twin's gait; the
same walks with true steps and an attitude that is off by a slowly varying 3 degrees; and the minimal swinging thigh of
the method sheet, which shares no code with the twin, with true steps and the same attitude error.

That the skew of the swing tells which way is forward is built into both generators, so its share of right signs says
only that noise does not matter; no recording at hand has a gyroscope on a thigh.

The phone walks from its first second on and never rests, so that its gyroscope's bias must be told on the way; what
ten seconds of rest before the walk would help is measured too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.baselines.pocket_rivals import RIVALS, rival_headings
from benchmarks.gait_walks import GARDEN, PARK, Walk, hops_of, replay, rested, swinging_thigh, twin_walk
from services.gateway.reckoning.calibration import Calibration
from services.gateway.reckoning.complementary import ComplementaryFilter
from services.gateway.reckoning.hops import HOP, RATE
from services.gateway.reckoning.pocket_heading import PocketHeading, principal_axis, swing_asymmetry
from services.gateway.reckoning.swing_length import SwingLength
from services.gateway.steps.gated_peaks import GatedPeaks
from shared.angles import wrap

__all__ = ["Told", "draw", "headings", "measure", "shipped", "sign_cues", "swing_length_errors", "tell"]

Array = NDArray[np.float64]

METHODS = ("pocket", *RIVALS)
RESTS = 10.0
"""Seconds that the phone of a rested walk lies still before it."""
SETTLES = 20.0
"""Seconds after which filter and detector have begun; ``pocket_settled_heading_deg`` is of the steps from there on."""


@dataclass(frozen=True, slots=True)
class Told:
    """What was told of the steps of one walk, from the third on.

    Attributes:
        t: (k,) s.
        heading: (k,) radians clockwise from north, by name of method.
        variance: (k,) rad², of ``pocket``.
        true: (k,) heading, rad.
        length: (k,) true length, m.
    """

    t: Array
    heading: dict[str, Array]
    variance: Array
    true: Array
    length: Array

    def error(self, method: str) -> Array:
        """Return the error (k,) rad in (-π, π]."""
        return wrap(self.heading[method] - self.true)

    def deviation(self, method: str) -> Array:
        """Return how far off each step ends, (k,) m."""
        return 2.0 * self.length * np.sin(np.abs(self.error(method)) / 2.0)


def shipped(walks: Sequence[Walk]) -> tuple[list[Walk], list[Array]]:
    """Return the walks with the attitude that the gateway makes out, and the steps that it finds, s."""
    calibration, attitude, detector = Calibration(), ComplementaryFilter(), GatedPeaks()
    states = [np.zeros(len(walks), part.STATE) for part in (calibration, attitude, detector)]
    turned, rates, phones, times = [], [], [], []
    for raw in hops_of(walks):
        rate, hops = calibration.advance(states[0], raw)
        turned.append(attitude.advance(states[1], hops, rate))
        rates.append(rate)
        steps = detector.advance(states[2], hops)
        phones.append(steps.phone)
        times.append(steps.t)
    whole, unbiased = np.concatenate(turned, axis=1), np.concatenate(rates, axis=1)
    phone, t = np.concatenate(phones), np.concatenate(times)
    seen = [len(walk.acceleration) // HOP * HOP for walk in walks]
    known = [
        replace(
            walk,
            acceleration=walk.acceleration[:end],
            rate=unbiased[row, :end],
            field=walk.field[:end],
            attitude=whole[row, :end],
        )
        for row, (walk, end) in enumerate(zip(walks, seen, strict=True))
    ]
    return known, [t[(phone == row) & (t < end / RATE - 1.0)] for row, end in enumerate(seen)]


def headings(walks: Sequence[Walk], steps: Sequence[Array], method: PocketHeading) -> list[tuple[Array, Array, Array]]:
    """Return times, headings and variances that the method tells of each walk's steps."""
    state = np.zeros(len(walks), method.STATE)
    rows = []
    for recent, told in replay(walks, steps):
        found = method.advance(state, recent, told)
        rows.append(np.column_stack([told.phone, told.t, found.heading, found.variance]))
    table = np.concatenate(rows)
    each = [table[table[:, 0] == row] for row in range(len(walks))]
    return [(part[:, 1], part[:, 2], part[:, 3]) for part in each]


def tell(walks: Sequence[Walk], steps: Sequence[Array], settles: float = 0.0) -> list[Told]:
    """Return what all methods tell of the same steps, those of the first ``settles`` seconds left out."""
    all_told = []
    for walk, mine in zip(walks, steps, strict=True):
        (t, heading, variance) = headings([walk], [mine], PocketHeading())[0]
        used = mine[: len(t)]
        true = walk.heading_at(t)
        scored = (t[2:] > settles) & (t[2:] - t[:-2] < 2.0)
        told = {"pocket": heading[2:][scored]}
        for name, axis in RIVALS.items():
            told[name] = rival_headings(axis, walk.acceleration, walk.rate, walk.attitude, used, float(true[2]))[scored]
        all_told.append(Told(t[2:][scored], told, variance[2:][scored], true[2:][scored], walk.lengths(t)[2:][scored]))
    return all_told


def sign_cues(walk: Walk) -> NDArray[np.bool_]:
    """Return for every true stride whether the skew of its swing alone points along the walk rather than back."""
    right = []
    rate = np.einsum("nij,nj->ni", walk.attitude[:, :2], walk.rate)
    for begin, end in zip(walk.steps[:-2], walk.steps[2:], strict=True):
        turning = rate[None, round(begin * RATE) : round(end * RATE)]
        line = principal_axis(turning)[0]
        across = np.array([-line[1], line[0]])
        cue = across * np.sign(swing_asymmetry(turning)[0] @ across)
        heading = walk.heading_at(np.array([end]))[0]
        right.append(cue @ [np.sin(heading), np.cos(heading)] > 0.0)
    return np.array(right)


def measure(seed: int, walkers: int = 8) -> dict[str, float]:
    """Return the figures of ``walkers`` walks on the twin (park and garden by turns) and as many swinging thighs."""
    twin = _twin(seed, walkers)
    calm = [rested(walk, np.random.default_rng([seed, row]), RESTS) for row, walk in enumerate(twin)]
    thighs = [swinging_thigh(np.random.default_rng([seed, number])) for number in range(walkers)]
    known = shipped(twin)
    told = tell(*known)
    figures = {"pocket_steps": float(sum(len(each.t) for each in told))}
    for name in METHODS:
        errors = np.degrees(np.abs(np.concatenate([each.error(name) for each in told])))
        deviations = np.concatenate([each.deviation(name) for each in told])
        figures |= {
            f"{name}_heading_deg": float(np.median(errors)),
            f"{name}_heading_deg_p75": float(np.percentile(errors, 75)),
            f"{name}_deviation_m": float(np.median(deviations)),
            f"{name}_deviation_m_p75": float(np.percentile(deviations, 75)),
        }
    squares = np.concatenate([each.error("pocket") ** 2 / each.variance for each in told])
    figures["pocket_normalised_error"] = float(np.mean(squares))
    figures["pocket_flipped"] = float(np.mean(np.abs(np.concatenate([e.error("pocket") for e in told])) > np.pi / 2))
    figures["pocket_sign_right"] = float(np.mean(np.concatenate([sign_cues(walk) for walk in twin])))
    lengths = [swing_length_errors(walk) for walk in twin]
    figures["swing_length_step_error"] = float(np.median(np.abs(np.concatenate(lengths))))
    figures["swing_length_distance_error"] = float(np.median([abs(each.mean()) for each in lengths]))
    figures["pocket_rested_heading_deg"] = _medians(tell(*shipped(calm), RESTS))["pocket"]
    figures["pocket_settled_heading_deg"] = _medians(tell(*known, SETTLES))["pocket"]
    for label, group in (("known_steps", twin), ("thigh", thighs)):
        for name, median in _medians(tell(group, [walk.steps for walk in group])).items():
            figures[f"{label}_{name}_heading_deg"] = median
    return figures


def swing_length_errors(walk: Walk, calibration: float = 20.0) -> Array:
    """Return the share by which single steps are told too long, after ``calibration`` seconds of known distance."""
    method = SwingLength()
    state = np.zeros(1, method.STATE)
    rows = []
    for recent, steps in replay([walk], delay=0.0):
        rows.append(np.column_stack([steps.t, method.advance(state, recent, steps)]))
        if state["scale"][0] == 0.0 and len(steps.t) and steps.t[-1] > walk.steps[0] + calibration:
            method.calibrate(state, np.array([walk.lengths(np.concatenate(rows)[:, 0]).sum()]))
    table = np.concatenate(rows)
    told = np.isfinite(table[:, 1])
    return np.asarray(table[told, 1] / walk.lengths(table[:, 0])[told] - 1.0)


def draw(seed: int, path: Path, walkers: int = 8) -> None:
    """Draw the distribution of the heading error by method, and one walk's headings."""
    told = tell(*shipped(_twin(seed, walkers)))
    figure = Figure((11.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name in METHODS:
        errors = np.sort(np.degrees(np.abs(np.concatenate([each.error(name) for each in told]))))
        left.plot(errors, np.arange(1, len(errors) + 1) / len(errors), label=name, lw=2.5 if name == "pocket" else 1.0)
    left.set(xlim=(0, 40), xlabel="heading error of a step, degrees", ylabel="share of steps")
    left.legend()
    one = told[min(1, len(told) - 1)]
    for name in ("pca2d", "pocket"):
        right.plot(one.t, np.degrees(np.unwrap(one.true + one.error(name))), ".", ms=3, label=name)
    right.plot(one.t, np.degrees(one.true), "k", lw=1, label="true")
    right.set(xlabel="s", ylabel="heading, degrees", title="one walk")
    right.legend()
    figure.savefig(path, dpi=110)


def _twin(seed: int, walkers: int) -> list[Walk]:
    return [twin_walk(1000 * seed + number, GARDEN if number % 2 else PARK) for number in range(walkers)]


def _medians(told: Sequence[Told]) -> dict[str, float]:
    return {
        name: float(np.median(np.degrees(np.abs(np.concatenate([each.error(name) for each in told])))))
        for name in METHODS
    }
