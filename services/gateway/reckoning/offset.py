"""How far is a phone in the hand turned against the walk? [self-calibrating-rss-thesis §3.5].

Forward acceleration repeats once per step, sideways acceleration once per two steps. Where the phone is turned, forward
acceleration shows beside it too: how much, as a ratio of spectra at the step frequency, is how far; on which side it
is while the walker brakes is the sign.

**Not applied by default.** On 103 legs over 10 m of the shopping-mall recordings, whose phones point ahead, the offset
told is 16 degrees to the left (median) and does not go along with the true error of the heading (correlation 0.08); a
tenth of it already makes the median heading worse (7.6 to 8.1 degrees), all of it much worse (20.6). A real hand moves
sideways at the step frequency too, by a third of what it moves ahead; a simulated one does not, and there the sign is
hardly ever wrong. The same recordings turned in software give the sign as often as the original study: 70 % of windows
at 15 degrees, 91 % at 30 (``benchmarks/offset_signs.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from services.gateway.reckoning.hand_heading import pointing
from services.gateway.reckoning.hops import RATE, Array, State
from services.gateway.reckoning.recent import KEPT, Recent
from services.gateway.reckoning.step_heading import UNKNOWN_VARIANCE
from services.gateway.steps.detector import Steps

__all__ = ["ERROR_SIGMA", "SIGN_RIGHT", "Offset", "Offsets", "Ratio", "Sign", "horizontal", "window_offsets"]

Ratio = Literal["per_axis", "common"]
Sign = Literal["braking", "harmonic"]

ERROR_SIGMA = np.radians(6.4)
"""rad; of either mode of the error, near 0 and near minus twice the offset [Tables 5.1, 5.2: 6.3 to 6.55 degrees]."""
SIGN_RIGHT = 0.705
"""How often one window gets the sign right [same tables: 0.72 and 0.69]."""

_POINTS = 512  # of the DFT: zero-padded, for a step frequency falls between the bins of a short window
_BAND = np.arange(int(1.2 * _POINTS / RATE), int(2.8 * _POINTS / RATE))  # step frequencies


@dataclass(frozen=True, slots=True)
class Offsets:
    """Offsets of the phones of m steps.

    Attributes:
        offset: (m,) of the phone's forward direction against the walk, radians, left (counter-clockwise) is positive:
            the compass heading of the walk is the phone's plus ``offset``. 0 where nothing is known.
        variance: (m,) rad², if the sign is right.
        wrong_sign_probability: (m,) of ``-offset`` being right, at most one half.
    """

    offset: Array
    variance: Array
    wrong_sign_probability: Array


class Offset:
    """Windows of four seconds, one each second of walking; what they say is averaged and their signs vote.

    Args:
        ratio: of the spectra. ``per_axis`` is Eq. 3.21 as printed: each axis' peak is a share of its own total.
            ``common`` compares the peaks themselves, which makes the tangent exact.
        sign: ``braking`` is Eq. 3.22 as printed: the side at the one strongest braking of the last second.
            ``harmonic`` asks the same of the step frequency's part alone, from which sway has gone.
        memory: seconds after which a window counts 1/e: people change their grip.
    """

    STATE = np.dtype([("size", np.float64), ("weight", np.float64), ("spread", np.float64), ("log_odds", np.float64)])
    WINDOW = int(4.0 * RATE)

    def __init__(self, ratio: Ratio = "common", sign: Sign = "harmonic", memory: float = 30.0) -> None:
        self._ratio: Ratio = ratio
        self._sign: Sign = sign
        self._keep = np.exp(-1.0 / memory)
        # Harmonic windows overlap by three quarters: four of them are one vote.
        self._vote = np.log(SIGN_RIGHT / (1.0 - SIGN_RIGHT)) * (0.25 if sign == "harmonic" else 1.0)

    def advance(self, state: State, recent: Recent, steps: Steps) -> Offsets:
        """Return the offsets of the phones that stepped and change ``state`` (p,) of ``STATE`` in place."""
        walking = np.flatnonzero(steps.walking & (recent.count >= self.WINDOW))
        if len(walking):
            newest = slice(KEPT - self.WINDOW, None)
            measured, turned = recent.acceleration[walking, newest], recent.attitude[walking, newest]
            waves = horizontal(measured.astype(np.float64), turned.astype(np.float64))
            self._learn(state, walking, window_offsets(*waves, self._ratio, self._sign))
        mine = state[steps.phone]
        known, sure = mine["weight"] > 0.0, np.abs(mine["log_odds"])
        offset = np.where(known, np.sign(mine["log_odds"]) * mine["size"], 0.0)
        error = ERROR_SIGMA**2 + mine["spread"] / np.maximum(mine["weight"], 1.0)
        return Offsets(offset, np.where(known, error, UNKNOWN_VARIANCE), 1.0 / (1.0 + np.exp(sure)))

    def _learn(self, state: State, phone: NDArray[np.int64], found: Array) -> None:
        size, weight = state["size"][phone], self._keep * state["weight"][phone] + 1.0
        off = np.abs(found) - size
        first = weight == 1.0
        spread = np.where(first, ERROR_SIGMA**2, state["spread"][phone])
        state["size"][phone] = size + off / weight
        state["spread"][phone] = spread + np.where(first, 0.0, (off**2 - spread) / weight)
        state["log_odds"][phone] = self._keep * state["log_odds"][phone] + self._vote * np.sign(found)
        state["weight"][phone] = weight


def horizontal(acceleration: Array, attitude: Array) -> tuple[Array, Array]:
    """Return the horizontal acceleration along where phones point and to the right of it, each (k, n), m/s².

    Args:
        acceleration: (k, n, 3) m/s², phone axes.
        attitude: (k, n, 3, 3) rotations from the phone's axes to (east, north, up).
    """
    world = np.einsum("pnij,pnj->pni", attitude[:, :, :2], acceleration)
    ahead = pointing(attitude)
    ahead = ahead / np.maximum(np.hypot(ahead[:, :, 0], ahead[:, :, 1]), 1e-6)[:, :, None]
    along = world[:, :, 0] * ahead[:, :, 0] + world[:, :, 1] * ahead[:, :, 1]
    right = world[:, :, 0] * ahead[:, :, 1] - world[:, :, 1] * ahead[:, :, 0]
    return along, right


def window_offsets(ahead: Array, right: Array, ratio: Ratio = "common", sign: Sign = "harmonic") -> Array:
    """Return the signed offset (k,), radians up to 45 degrees, left positive, of windows (k, n) of m/s² at ``RATE``."""
    ahead = ahead - ahead.mean(axis=1, keepdims=True)
    right = right - right.mean(axis=1, keepdims=True)
    taper = np.hanning(ahead.shape[1])
    along, beside = (np.fft.rfft(wave * taper, _POINTS, axis=1) for wave in (ahead, right))
    peak = _BAND[0] + np.abs(along[:, _BAND]).argmax(axis=1)
    rows = np.arange(len(ahead))
    step_ahead, step_beside = along[rows, peak], beside[rows, peak]
    size_ahead, size_beside = np.abs(step_ahead), np.abs(step_beside)
    if ratio == "per_axis":
        size_ahead = size_ahead / np.maximum(np.abs(along[:, 1:-1]).sum(axis=1), 1e-9)
        size_beside = size_beside / np.maximum(np.abs(beside[:, 1:-1]).sum(axis=1), 1e-9)
    size = np.minimum(np.arctan2(size_beside, size_ahead), np.pi / 4.0)
    if sign == "braking":
        last = int(RATE)
        at = ahead[:, -last:].argmin(axis=1)
        side = -right[rows, at - last]
    else:
        side = (step_beside * step_ahead.conj()).real
    signed: Array = np.where(side < 0.0, -size, size)
    return signed
