"""How many steps fill these seconds? DFT windows cut to whole steps [nonvisual-visual-fusion-dissertation §2.3]."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from services.gateway.reckoning.hops import HOP, RATE, Array, Hops, State
from services.gateway.steps.detector import Steps

__all__ = ["PEAKS", "AdaptiveDft", "contrast", "fitted_sines"]

Single = NDArray[np.float32]

LONGEST = int(6.0 * RATE)
"""Samples of the coarse window."""
LENGTHS = np.arange(LONGEST - int(2.0 * RATE) + 1, LONGEST + 1)
"""Windows tried: the last two seconds (200 lengths at 100 Hz)."""
CADENCE = (1.1, 2.5)
"""Hz, of steps; without a band the harmonics of a footfall win."""
Peak = Literal["fitted", "raw"]
PEAKS: tuple[Peak, ...] = ("fitted", "raw")
SINES = 4
"""Terms of the fit."""

_FIRST = int(CADENCE[0] * LENGTHS[0] / RATE)
_CYCLES = np.arange(_FIRST - 1, int(np.ceil(CADENCE[1] * LONGEST / RATE)) + 2)
_PERIODS = np.geomspace(0.25, 4.0, 40) * RATE  # of the sines: a step makes one ripple
_KEPT = LONGEST + HOP
_SECOND = np.arange(-HOP // 2, HOP // 2)


@dataclass(frozen=True, slots=True)
class AdaptiveDft:
    """Takes six seconds, cuts them to a whole number of steps, spreads these evenly, and begins anew at the cut.

    The contrast of the strongest bin against its neighbours peaks where a window holds whole cycles. It is computed on
    the norm, whose cycle is a step in any pose; on raw axes, as published, a step is easily taken for a stride. The
    dissertation has no gate: ours is the norm's deviation, of the window and of the second around each step, and the
    strongest bin's share of the power.

    Attributes:
        peak: where the contrast's peak is looked for: on a least-squares sum of sines, as published, or on itself.
        lowest: m/s², standard deviation of a walk's norm.
        share: of the power in the strongest bin and its neighbours.
    """

    peak: Peak = "raw"
    lowest: float = 0.8
    share: float = 0.1

    STATE = np.dtype(
        [
            ("norm", np.float64, (_KEPT,)),
            ("open", np.int64),
            ("walking", np.bool_),
            ("period", np.float64),
        ]
    )
    """Of one phone: 3 kB. ``open``: newest samples that are not yet judged."""

    def advance(self, state: State, hops: Hops) -> Steps:
        """Take one hop of each of p phones and return the steps it led to."""
        norm = np.sqrt(np.einsum("pni,pni->pn", hops.acceleration, hops.acceleration))
        state["norm"] = np.concatenate([state["norm"][:, HOP:], norm], axis=1)
        # What ends in a hole cannot fill a window any more.
        state["open"] = np.where(hops.count == HOP, state["open"] + HOP, 0)
        state["walking"] &= (hops.count == HOP) & (norm.std(axis=1) > self.lowest)
        full = np.flatnonzero(state["open"] >= LONGEST)
        phones, times = [np.empty(0, np.int64)], [np.empty(0)]
        if len(full):
            begin = _KEPT - state["open"][full]
            window = state["norm"][full[:, None], begin[:, None] + np.arange(LONGEST)]
            steps, length, walks = self._cut(window - window.mean(axis=1, keepdims=True))
            state["open"][full] -= np.where(walks, length, HOP)
            state["walking"][full] = walks
            state["period"][full] = np.where(walks, length / np.maximum(steps, 1) / RATE, 0.0)
            begun = hops.t[full] + (begin - LONGEST) / RATE
            for row in np.flatnonzero(walks):
                place = np.arange(1, steps[row] + 1) * length[row] / steps[row]
                second = np.clip(place.astype(np.int64)[:, None] + _SECOND, 0, LONGEST - 1)
                place = place[window[row, second].std(axis=1) > self.lowest]
                phones.append(np.full(len(place), full[row]))
                times.append(begun[row] + place / RATE)
            state["walking"][full] &= norm[full].std(axis=1) > self.lowest
        period = np.where(state["walking"], state["period"], 0.0)
        return Steps(np.concatenate(phones), np.concatenate(times), state["walking"].copy(), period)

    def _cut(self, window: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
        """Return steps, samples that they take, and whether that is walking, (m,) each, of windows (m, LONGEST)."""
        cycles, curve, share = contrast(window)
        places = np.empty(len(window), np.int64)
        for row, values in enumerate(curve):
            wave = fitted_sines(values) if self.peak == "fitted" else values
            places[row] = _highest_peak(wave)
        found = np.maximum(places, 0)
        rows = np.arange(len(window))
        walks = (places >= 0) & (window.std(axis=1) > self.lowest) & (share[rows, found] > self.share)
        return cycles[rows, found], LENGTHS[found], walks


def contrast(window: Array) -> tuple[NDArray[np.int64], Array, Array]:
    """Return the strongest whole number of cycles, its contrast to its neighbours and its share of the power.

    Args:
        window: (m, LONGEST), without its mean.

    Returns:
        (m, len(LENGTHS)) each, of the first ``LENGTHS`` samples; the contrast per sample, so that lengths compare.
    """
    cos, sin = _bases()
    samples = window.astype(np.float32)
    size = (len(window), len(LENGTHS), len(_CYCLES))
    magnitude = np.hypot((samples @ cos).reshape(size), (samples @ sin).reshape(size)) / LENGTHS[:, None]
    fewest, most = (np.array(CADENCE)[:, None] * LENGTHS / RATE)[..., None]
    usable = (np.floor(fewest) <= _CYCLES) & (np.ceil(most) >= _CYCLES)
    usable[:, [0, -1]] = False  # they are neighbours only
    best = np.where(usable, magnitude, -1.0).argmax(axis=2)
    around = np.take_along_axis(magnitude, best[..., None] + np.arange(-1, 2), axis=2)
    power = np.cumsum(window**2, axis=1)[:, LENGTHS - 1] / LENGTHS
    share = 2.0 * (around**2).sum(axis=2) / np.maximum(power, 1e-9)
    return _CYCLES[best], around.var(axis=2), share


def fitted_sines(curve: Array) -> Array:
    """Return the sum of ``SINES`` sines and a constant nearest to a curve (n,), added singly, fitted together."""
    n = np.arange(len(curve))
    bases, orthonormal = _sines()
    columns = [np.ones((len(n), 1))]
    rest = curve - curve.mean()
    for _ in range(SINES):
        energy = (np.einsum("knj,n->kj", orthonormal, rest) ** 2).sum(axis=1)
        columns.append(bases[int(np.argmax(energy))])
        design = np.concatenate(columns, axis=1)
        fit: Array = design @ np.linalg.lstsq(design, curve, rcond=None)[0]
        rest = curve - fit
    return fit


def _highest_peak(wave: Array) -> int:
    """Return the place of the highest local maximum of a curve, -1 where it has none."""
    peaks = 1 + np.flatnonzero((wave[1:-1] > wave[:-2]) & (wave[1:-1] >= wave[2:]))
    return int(peaks[np.argmax(wave[peaks])]) if len(peaks) else -1


@cache
def _bases() -> tuple[Single, Single]:
    """Return what cuts and transforms windows, cosines and sines: (LONGEST, lengths x cycles) each."""
    n = np.arange(LONGEST)[:, None, None]
    phase = 2.0 * np.pi * n * _CYCLES / LENGTHS[:, None]
    inside = n < LENGTHS[:, None]
    cos, sin = ((wave(phase) * inside).reshape(LONGEST, -1).astype(np.float32) for wave in (np.cos, np.sin))
    return cos, sin


@cache
def _sines() -> tuple[Array, Array]:
    """Return sine and cosine of each period, (k, n, 2), as they are and orthonormal."""
    phase = 2.0 * np.pi * np.arange(len(LENGTHS)) / _PERIODS[:, None]
    bases = np.stack([np.sin(phase), np.cos(phase)], axis=2)
    return bases, np.linalg.qr(bases)[0]
