"""Which stretches of acceleration may be a step, and which word says what each looks like? [ravel-thesis §9]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, group_delay, sos2tf, sosfilt, sosfilt_zi
from scipy.stats import norm

from services.gateway.reckoning.hops import HOP, RATE, Array, Hops, State

__all__ = ["SYMBOLS", "WORD", "Candidates", "StepWords"]

WORD = 10
"""Means of a word."""
SYMBOLS = 16
"""Of the alphabet, equally probable in Gaussian noise."""
LOW_PASS = 3.0
"""Hz, eighth order; the thesis does not print it."""
HIGH_PASS = 0.3
"""Hz; the same."""
_KEPT = 2 * HOP
_HIGH = butter(2, HIGH_PASS, "highpass", fs=RATE, output="sos")
_LOW = butter(8, LOW_PASS, "lowpass", fs=RATE, output="sos")
_HIGH_SETTLED, _LOW_SETTLED = sosfilt_zi(_HIGH), sosfilt_zi(_LOW)
_DELAY = round(float(group_delay(sos2tf(_LOW), w=[1.8], fs=RATE)[1][0]))
_BREAKS = norm.ppf(np.arange(1, SYMBOLS) / SYMBOLS)


@dataclass(frozen=True, slots=True)
class Candidates:
    """Stretches that passed the state machine and its three validations.

    Attributes:
        phone: (m,) rows, ascending.
        t: (m,) s, when the heel came down: the end.
        duration: (m,) s.
        word: (m, WORD) symbols, 0 to SYMBOLS - 1.
    """

    phone: NDArray[np.int64]
    t: Array
    duration: Array
    word: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class StepWords:
    """Cuts the norm from one downward zero crossing of its low pass to the next.

    The thesis' state machine waits for a downward crossing, the least value, the greatest, and the next crossing: that
    is one stretch between two downward crossings. Loosened against the thesis, whose phone is in a front pocket, at
    100 Hz, on its vertical axis: we take the norm (any pose), and wider validations, since as published (0.4 to 0.8 s,
    0.2 to 0.4 s) the machine misses a third of the steps of other positions.

    Attributes:
        shortest: s.
        longest: s.
        apart: s from least to greatest value, at least and at most.
        lowest: m/s², of both.
    """

    shortest: float = 0.3
    longest: float = 1.1
    apart: tuple[float, float] = (0.1, 0.7)
    lowest: float = 0.3

    STATE = np.dtype(
        [
            ("begun", np.bool_),
            ("high", np.float64, _HIGH_SETTLED.shape),
            ("low", np.float64, _LOW_SETTLED.shape),
            ("before", np.float64, (_KEPT,)),
            ("after", np.float64, (_KEPT,)),
        ]
    )

    def advance(self, state: State, hops: Hops) -> Candidates:
        """Take one hop of each of p phones and return the stretches that end in it."""
        before, after = self._filtered(state, hops)
        down = (after[:, :-1] > 0.0) & (after[:, 1:] <= 0.0)
        phone, crossing = np.nonzero(down)
        crossing += 1
        same = phone[1:] == phone[:-1]
        ends = crossing[1:] >= _KEPT
        ends &= crossing[1:] < _KEPT + hops.count[phone[1:]]
        begin, end = crossing[:-1][same & ends], crossing[1:][same & ends]
        phone = phone[1:][same & ends]
        duration = (end - begin) / RATE
        fits = (duration >= self.shortest) & (duration <= self.longest)
        phone, begin, end, duration = phone[fits], begin[fits], end[fits], duration[fits]
        span = np.arange(int(self.longest * RATE) + 1)
        inside = span < (end - begin)[:, None]
        wave = after[phone[:, None], np.minimum(begin[:, None] + span, after.shape[1] - 1)]
        least = np.where(inside, wave, np.inf).argmin(axis=1)
        most = np.where(inside, wave, -np.inf).argmax(axis=1)
        apart = (most - least) / RATE
        rows = np.arange(len(phone))
        valid = (apart >= self.apart[0]) & (apart <= self.apart[1])
        valid &= (-wave[rows, least] > self.lowest) & (wave[rows, most] > self.lowest) if len(phone) else valid
        phone, begin, end, duration = phone[valid], begin[valid], end[valid], duration[valid]
        t = hops.t[phone] + (end - _KEPT - _DELAY) / RATE
        word = _words(before, phone, begin - _DELAY, end - _DELAY)
        return Candidates(phone, t, duration, word)

    def _filtered(self, state: State, hops: Hops) -> tuple[Array, Array]:
        """Return the norm without gravity before and after the low pass, (p, _KEPT + HOP) each."""
        raw = np.sqrt(np.einsum("pni,pni->pn", hops.acceleration, hops.acceleration))
        begun = state["begun"][:, None, None]
        zi = np.where(begun, state["high"], _HIGH_SETTLED * raw[:, :1, None])
        high, zi = sosfilt(_HIGH, raw, axis=1, zi=zi.transpose(1, 0, 2))
        state["high"] = zi.transpose(1, 0, 2)
        low, zi = sosfilt(_LOW, high, axis=1, zi=state["low"].transpose(1, 0, 2))
        state["low"] = zi.transpose(1, 0, 2)
        state["begun"] = True
        both = []
        for name, values in (("before", high), ("after", low)):
            both.append(np.concatenate([state[name], values], axis=1))
            state[name] = both[-1][:, -_KEPT:]
        return both[0], both[1]


def _words(
    wave: Array, phone: NDArray[np.int64], begin: NDArray[np.int64], end: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the SAX words (m, WORD) of the samples ``begin`` to ``end`` of ``wave``, each scaled to unit variance."""
    sums, squares = (
        np.concatenate([np.zeros((len(wave), 1)), np.cumsum(power, axis=1)], axis=1) for power in (wave, wave**2)
    )
    begin, end = np.maximum(begin, 0), np.maximum(end, 1)
    edges = begin[:, None] + np.linspace(0.0, 1.0, WORD + 1) * (end - begin)[:, None]
    whole = np.minimum(edges.astype(np.int64), wave.shape[1] - 1)
    rows = phone[:, None]
    at_edges = sums[rows, whole] + (edges - whole) * wave[rows, whole]
    size = (end - begin)[:, None]
    means = np.diff(at_edges, axis=1) / (size / WORD)
    mean = (sums[rows, end[:, None]] - sums[rows, begin[:, None]]) / size
    power = (squares[rows, end[:, None]] - squares[rows, begin[:, None]]) / size
    scaled = (means - mean) / np.sqrt(np.maximum(power - mean**2, 1e-6))
    word: NDArray[np.int64] = np.searchsorted(_BREAKS, scaled).astype(np.int64)
    return word
