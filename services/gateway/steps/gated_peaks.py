"""Which peaks of the acceleration are steps? Those that repeat themselves as steps do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, group_delay, sos2tf, sosfilt, sosfilt_zi

from services.gateway.reckoning.hops import HOP, RATE, Array, Hops, State
from services.gateway.steps.detector import LONGEST_DELAY, Steps
from services.gateway.steps.rhythm import rhythm
from services.gateway.steps.spacing import CLOCK_STEP, spaced

__all__ = ["GatedPeaks"]

BAND = (0.6, 2.6)
"""Hz: steps, and neither the swing of an arm nor the ring of a heel."""
WINDOW = int(4.0 * RATE)
"""Samples over which a walk must repeat itself."""
SHORT = int(1.5 * RATE)
"""Samples that tell how hard somebody steps now."""
REMEMBERED = 12
"""Peaks that wait until it is clear whether they are steps."""

_UNKNOWN = 1e3
"""s, between two peaks of which only one was."""
_SOS = butter(2, BAND, "bandpass", fs=RATE, output="sos")
_SETTLED = sosfilt_zi(_SOS)
_DELAY = float(group_delay(sos2tf(_SOS), w=[1.8], fs=RATE)[1][0] + 1.0) / RATE
_HERE = slice(WINDOW - 1, WINDOW + HOP - 1)  # a peak is known one sample later: the hop's samples, one earlier


@dataclass(frozen=True, slots=True)
class GatedPeaks:
    """Peaks of the band-passed norm, told only while they are regular; no gravity, pose or person need be known.

    A peak counts above ``lowest``, ``over_rms`` of the last 1.5 s and ``over_walk`` of the last 4 s (against a walk
    just over, what the hand then does is small), and outside the refractory time. A walk begins with enough regular
    peaks, few if they are very regular, and then tells them all. While its rhythm is bad its peaks wait; they are told
    when it comes back, or forgotten ``resume`` after the last that was told. A walk ends after ``stop_after`` of bad
    rhythm, or after ``silence`` without a peak. Where the numbers come from: ``benchmarks/step_table.py``.

    Attributes:
        lowest: m/s².
        over_rms: share.
        over_walk: share.
        refractory: s.
        refractory_share: of the step period, while walking.
        start_peaks: a walk begins with so many,
        start_correlation: at this autocorrelation,
        regular: each interval being so near to the median, as a share;
        quick_peaks: or with so many,
        quick_correlation: at this autocorrelation,
        quick_regular: and so near.
        slowest: s from step to step.
        stop_correlation: below this autocorrelation the rhythm is bad.
        stop_after: s.
        silence: s.
        resume: s.
    """

    lowest: float = 0.4
    over_rms: float = 0.3
    over_walk: float = 0.4
    refractory: float = 0.28
    refractory_share: float = 0.6
    start_peaks: int = 5
    start_correlation: float = 0.75
    regular: float = 0.25
    quick_peaks: int = 3
    quick_correlation: float = 0.75
    quick_regular: float = 0.2
    slowest: float = 1.3
    stop_correlation: float = 0.6
    stop_after: float = 3.5
    silence: float = 1.2
    resume: float = 5.0

    STATE = np.dtype(
        [
            ("begun", np.bool_),
            ("filter", np.float64, _SETTLED.shape),
            ("wave", np.float64, (WINDOW,)),
            ("last_peak", np.float64),
            ("last_told", np.float64),
            ("waiting", np.float64, (REMEMBERED,)),
            ("count", np.int64),
            ("walking", np.bool_),
            ("period", np.float64),
            ("irregular", np.float64),
        ]
    )
    """Of one phone: 2 kB."""

    def advance(self, state: State, hops: Hops) -> Steps:
        """Take one hop of each of p phones and return the steps it led to."""
        wave = self._filtered(state, hops)
        self._take_peaks(state, wave, hops)
        period, correlation = rhythm(wave[:, -WINDOW:])
        now = hops.t + (HOP - 1) / RATE
        run, quick_run = self._regular_runs(state)
        starts = (run >= self.start_peaks) & (correlation > self.start_correlation)
        starts |= (quick_run >= self.quick_peaks) & (correlation > self.quick_correlation)
        walked = state["walking"]
        starts &= ~walked
        resumes = (state["last_told"] > 0.0) & (now - state["last_told"] < self.resume)
        run = np.where(resumes, state["count"], np.maximum(run, quick_run))
        regular = correlation >= self.stop_correlation
        irregular = np.where(walked & ~regular, state["irregular"] + HOP / RATE, 0.0)
        silent = now - state["last_peak"] > self.silence
        walking = starts | (walked & ~silent & (irregular < self.stop_after))
        tells = np.where(starts, run, np.where(walked & regular, state["count"], 0))
        state["count"] = np.where(tells > 0, 0, state["count"])
        state["period"] = np.where(walking, np.where(regular | starts, period, state["period"]), 0.0)
        state["walking"] = walking
        state["irregular"] = irregular
        told = REMEMBERED - np.arange(REMEMBERED) <= tells[:, None]
        told &= state["waiting"] - _DELAY > (now - LONGEST_DELAY)[:, None]
        phone, place = np.nonzero(told)
        t = state["waiting"][phone, place]
        state["last_told"][phone] = t
        return Steps(phone, t - _DELAY, walking, state["period"].copy())

    def _filtered(self, state: State, hops: Hops) -> Array:
        """Return the band-passed norm of the window before the hop and of the hop, (p, WINDOW + HOP)."""
        norm = np.sqrt(np.einsum("pni,pni->pn", hops.acceleration, hops.acceleration))
        begun = state["begun"][:, None, None]
        before = np.where(begun, state["filter"], _SETTLED * norm[:, :1, None])
        filtered, after = sosfilt(_SOS, norm, axis=1, zi=before.transpose(1, 0, 2))
        wave = np.concatenate([state["wave"], filtered], axis=1)
        state["begun"] = True
        state["filter"] = after.transpose(1, 0, 2)
        state["wave"] = wave[:, -WINDOW:]
        return wave

    def _take_peaks(self, state: State, wave: Array, hops: Hops) -> None:
        """Let those of the hop's peaks wait that are high and late enough."""
        power = np.cumsum(wave**2, axis=1)
        short = power[:, _HERE] - power[:, WINDOW - 1 - SHORT : WINDOW - 1 - SHORT + HOP]
        long = power[:, _HERE]
        long[:, 1:] -= power[:, : HOP - 1]
        enough = np.sqrt(np.maximum(self.over_rms**2 / SHORT * short, self.over_walk**2 / WINDOW * long))
        value = wave[:, _HERE]
        peaks = value > np.maximum(self.lowest, enough)
        peaks &= (value > wave[:, WINDOW - 2 : WINDOW - 2 + HOP]) & (value >= wave[:, WINDOW:])
        phone, place = np.nonzero(peaks & hops.measured())
        t = hops.t[phone] + place / RATE
        gap = np.maximum(self.refractory, self.refractory_share * state["period"])
        kept = spaced(phone, t, state["last_peak"], gap)
        for row, when in zip(phone[kept].tolist(), t[kept].tolist(), strict=True):
            waiting = state["waiting"][row]
            waiting[:-1] = waiting[1:]
            waiting[-1] = when
        state["count"] = np.minimum(state["count"] + np.bincount(phone[kept], minlength=len(state)), REMEMBERED)

    def _regular_runs(self, state: State) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return how many of the newest waiting peaks are regular, (p,), and how many as a quick start wants them."""
        waiting = state["waiting"]
        intervals = np.where(waiting[:, :-1] > 0.0, np.diff(waiting, axis=1), _UNKNOWN)[:, ::-1]
        known = np.arange(1, REMEMBERED) < state["count"][:, None]
        runs = []
        for peaks, within in ((self.start_peaks, self.regular), (self.quick_peaks, self.quick_regular)):
            newest = np.sort(intervals[:, : peaks - 1], axis=1)
            middle = 0.5 * (newest[:, [(peaks - 2) // 2]] + newest[:, [(peaks - 1) // 2]])
            fits = known & (np.abs(intervals - middle) <= within * middle + CLOCK_STEP) & (middle <= self.slowest)
            runs.append(1 + np.cumprod(fits, axis=1).sum(axis=1))
        return runs[0], runs[1]
