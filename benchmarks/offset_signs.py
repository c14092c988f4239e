"""How often does walking tell rightly to which side a phone in the hand is turned, and does it help real headings?

On the twin as the original study did it: ten walks, five with the phone turned by 30 degrees to either side and five
by 15 [self-calibrating-rss-thesis §8.2, E3.5, E3.6]. Then on the recordings of a shopping mall, whose phones point
ahead: as they are, and turned by as much in software. And where strap-down integration gets to (§3.3 there).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.baselines.strap_down import strap_down
from benchmarks.gait_walks import Walk, replay, twin_walk
from benchmarks.mall_traces import Trace
from services.gateway.reckoning.hand_heading import pointing
from services.gateway.reckoning.hops import HOP, RATE
from services.gateway.reckoning.offset import ERROR_SIGMA, SIGN_RIGHT, Offset, Sign, horizontal, window_offsets
from services.gateway.reckoning.recent import KEPT
from services.simulator.phones.carrying import CarryingParameters
from shared.angles import wrap

__all__ = ["draw", "error_modes", "mall", "measure", "turn", "window_errors"]

Array = NDArray[np.float64]

WALKS = 5
"""Of each size of the offset."""
ROUTE = [(90.0, 0.0)]
POINTING_AHEAD = CarryingParameters(offset=0.0, regrip_every=0.0)
LEG = 10.0
"""Metres that a leg of the mall has at least."""
SETTLES = 1.2
"""Seconds after a way-point that are left out: people turn about a second late."""
_SIGNS: dict[Sign, str] = {"harmonic": "", "braking": "_braking"}  # to the ending of figures' names


def turn(walk: Walk, offset: float) -> Walk:
    """Return the walk as a phone measures it that is turned by ``offset`` to the left, radians, about the vertical."""
    turned = Rotation.from_euler("Z", offset).as_matrix()
    # Seen from the phone, whose attitude becomes turned x attitude, what was v in the room is attitude' turned' v.
    back = np.einsum("nji,jk,nkl->nil", walk.truth, turned.T, walk.truth)
    return Walk(
        acceleration=np.einsum("nij,nj->ni", back, walk.acceleration),
        rate=np.einsum("nij,nj->ni", back, walk.rate),
        field=np.einsum("nij,nj->ni", back, walk.field),
        truth=turned @ walk.truth,
        attitude=turned @ walk.attitude,
        heading=walk.heading,
        walked=walk.walked,
        steps=walk.steps,
        offset=walk.offset + offset,
    )


def window_errors(walks: Sequence[Walk], sign: Sign = "harmonic") -> list[tuple[Array, Array]]:
    """Return of each walk the offsets that its windows tell and their truth, each (k,) rad; one window a second."""
    found: list[list[Array]] = []
    for recent, _ in replay(walks):
        if int(recent.count.min()) >= 2 * Offset.WINDOW:
            newest = slice(KEPT - Offset.WINDOW, None)
            waves = horizontal(recent.acceleration[:, newest].astype(float), recent.attitude[:, newest].astype(float))
            found.append(list(window_offsets(*waves, sign=sign)))
    told = np.array(found).T
    first = 2 * Offset.WINDOW // HOP
    at = (np.arange(first, first + told.shape[1]) * HOP) - Offset.WINDOW // 2
    return [(mine, walk.offset[at]) for mine, walk in zip(told, walks, strict=True)]


def error_modes(errors: Array, size: float) -> dict[str, float]:
    """Return share and spread of the two modes of the errors (k,) rad of an offset of ``size`` rad, signs turned up."""
    right = errors > -size
    degrees = np.degrees(errors)
    return {
        "right_share": float(right.mean()),
        "right_mean_deg": float(degrees[right].mean()) if right.any() else np.nan,
        "right_sigma_deg": float(degrees[right].std()) if right.any() else np.nan,
        "wrong_mean_deg": float(degrees[~right].mean()) if (~right).any() else np.nan,
    }


def measure(seed: int, traces: Sequence[Trace] = ()) -> dict[str, float]:
    """Return the figures of ten walks and, where traces are given, of the mall."""
    figures: dict[str, float] = {}
    for degrees, first in ((30, 0), (15, WALKS)):
        walks = _turned_walks(seed, degrees, first)
        for sign, suffix in _SIGNS.items():
            told = window_errors(walks, sign)
            right = np.concatenate([np.sign(found) == np.sign(true) for found, true in told])
            figures[f"offset_sign_{degrees}{suffix}"] = float(right.mean())
            errors = np.concatenate([(found - true) * np.sign(true) for found, true in told])
            if degrees == 15:
                modes = error_modes(errors, np.radians(degrees))
                figures |= {f"offset_15{suffix}_{name}": value for name, value in modes.items()}
        figures[f"offset_windows_{degrees}"] = float(sum(len(found) for found, _ in told))
    figures |= _drift(seed)
    return figures | (mall(traces) if traces else {})


def mall(traces: Sequence[Trace]) -> dict[str, float]:
    """Return what the offset says of real phones that point ahead, and what it would make of their headings."""
    offsets, errors, windows = [], [], []
    for trace in traces:
        legs = trace.legs()
        for number in np.flatnonzero(legs.length > LEG):
            t = np.arange(legs.begin[number] + SETTLES, legs.end[number], 1.0 / RATE)
            if len(t) < Offset.WINDOW:
                continue
            acceleration, attitude = _at(trace, t)
            cut = [slice(end - Offset.WINDOW, end) for end in range(Offset.WINDOW, len(t) + 1, HOP)]
            ahead, right = horizontal(np.stack([acceleration[c] for c in cut]), np.stack([attitude[c] for c in cut]))
            windows.append((ahead, right))
            offsets.append(float(np.mean(window_offsets(ahead, right))))
            points = pointing(attitude).mean(axis=0)
            off = float(np.arctan2(points[0], points[1])) - (np.pi / 2.0 - legs.heading[number])
            errors.append(off)
    offset, error = np.array(offsets), wrap(np.array(errors))
    along, beside = (np.concatenate([pair[k] for pair in windows]) for k in (0, 1))
    sane = np.abs(error) < np.radians(60.0)  # beyond it the leg was not walked straight
    figures = {
        "mall_legs": float(len(error)),
        "mall_offset_deg": float(np.degrees(np.median(offset))),
        "mall_offset_correlation": float(np.corrcoef(offset[sane], -error[sane])[0, 1]),
    }
    for share, name in ((0.0, "without"), (0.1, "tenth"), (1.0, "with")):
        figures[f"mall_heading_{name}_offset_deg"] = float(np.degrees(np.median(np.abs(error + share * offset))))
    for degrees in (15, 30):
        right_signs: dict[Sign, list[float]] = {"harmonic": [], "braking": []}
        for side in (-1.0, 1.0):
            angle = side * np.radians(degrees)
            cos, sin = np.cos(angle), np.sin(angle)
            # Turned to the left, forward lies to the right of where the phone points.
            waves = cos * along - sin * beside, sin * along + cos * beside
            for sign, shares in right_signs.items():
                shares.append(float(np.mean(np.sign(window_offsets(*waves, sign=sign)) == side)))
        figures[f"mall_offset_sign_{degrees}"] = float(np.mean(right_signs["harmonic"]))
        figures[f"mall_offset_sign_{degrees}_braking"] = float(np.mean(right_signs["braking"]))
    return figures


def draw(seed: int, path: Path, traces: Sequence[Trace] = ()) -> None:
    """Draw the histogram of the error at 15 degrees beside the study's mixture, and where strap-down gets to."""
    figure = Figure((11.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    walks = _turned_walks(seed, 15, WALKS)
    bins = np.arange(-60.0, 61.0, 3.0)
    for sign in _SIGNS:
        told = window_errors(walks, sign)
        errors = np.degrees(np.concatenate([(found - true) * np.sign(true) for found, true in told]))
        left.hist(errors, bins, density=True, alpha=0.5, label=f"sign: {sign}")
    degrees, sigma = np.linspace(-60.0, 60.0, 241), np.degrees(ERROR_SIGMA)
    modes = [np.exp(-0.5 * ((degrees - mean) / sigma) ** 2) / (sigma * np.sqrt(2.0 * np.pi)) for mean in (0.0, -30.0)]
    left.plot(degrees, SIGN_RIGHT * modes[0] + (1.0 - SIGN_RIGHT) * modes[1], "k", lw=1, label="original study")
    left.set(xlabel="error of an offset of 15 degrees", ylabel="density", title="windows of the twin")
    left.legend()
    for walk in walks:
        t, _, position = _integrated(walk)
        right.plot(t, np.hypot(*(position - _path(walk)[: len(t)]).T))
    right.set(xlabel="s", ylabel="m", title="strap-down integration: off by")
    figure.savefig(path, dpi=110)


def _turned_walks(seed: int, degrees: float, first: int) -> list[Walk]:
    """Return five walks, each with the phone turned to the left and to the right."""
    walks = []
    for number in range(first, first + WALKS):
        walk = twin_walk(1000 * seed + number, ROUTE, "hand", habits=POINTING_AHEAD)
        walks += [turn(walk, side * float(np.radians(degrees))) for side in (-1.0, 1.0)]
    return walks


def _at(trace: Trace, t: Array) -> tuple[Array, Array]:
    """Return acceleration (n, 3) and the phone's own attitude (n, 3, 3) at even times, interpolated."""
    acceleration, vector = (
        np.column_stack([np.interp(t, trace.t, column) for column in values.T])
        for values in (trace.acceleration, trace.vector)
    )
    real = np.sqrt(np.maximum(1.0 - np.sum(vector**2, axis=1), 0.0))
    return acceleration, Rotation.from_quat(np.column_stack([vector, real])).as_matrix()


def _path(walk: Walk) -> Array:
    step = np.diff(walk.walked, prepend=0.0)
    return np.cumsum(step[:, None] * np.column_stack([np.sin(walk.heading), np.cos(walk.heading)]), axis=0)


def _integrated(walk: Walk) -> tuple[Array, Array, Array]:
    """Return times, velocity and position of strap-down integration that knows the first velocity."""
    path = _path(walk)
    velocity, position = strap_down(walk.acceleration, walk.attitude, 1.0 / RATE, (path[HOP] - path[0]) * RATE / HOP)
    return np.arange(len(path)) / RATE, velocity, position


def _drift(seed: int) -> dict[str, float]:
    """Return how far strap-down integration is off after 10, 30 and 60 s, and the speed it then tells; medians."""
    off, speed = [], []
    for walk in _turned_walks(seed, 0.0, 0)[::2]:
        _, velocity, position = _integrated(walk)
        off.append(np.hypot(*(position - _path(walk)).T))
        speed.append(np.hypot(*velocity.T))
    figures = {}
    for seconds in (10, 30, 55):
        at = round(seconds * RATE)
        figures[f"strap_down_drift_{seconds}s_m"] = float(np.median([each[at] for each in off]))
    figures["strap_down_speed_55s_mps"] = float(np.median([each[round(55 * RATE)] for each in speed]))
    return figures
