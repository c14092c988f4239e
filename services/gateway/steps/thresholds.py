"""Which peaks are steps, for this person? Two thresholds from a trial walk [self-calibrating-rss-thesis §3.6]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import center_of_mass, distance_transform_cdt, label

from services.gateway.reckoning.hops import HOP, RATE, Array, Hops, State
from services.gateway.reckoning.walking_detection import WalkingDetection
from services.gateway.steps.detector import Steps
from services.gateway.steps.spacing import spaced

__all__ = ["GRID", "LONGEST_TRIAL", "PersonalThresholds", "TrialError", "centre_of_zeros", "personalise"]

BESIDE = 3
"""Samples on either side of a peak whose mean must be high too: 0.14 s with the peak."""
SPACING = 0.33
"""s between steps: nobody walks at 3 Hz."""
LONGEST_TRIAL = 20
"""A trial walk has fewer steps."""
GRID = np.round(np.arange(9.9, 14.05, 0.1), 1)
"""m/s², of both thresholds; the thesis shows 12.3 to 13 for one phone in one hand."""
FORGIVEN = 2
"""Steps that even the best thresholds may miss: those before walking is detected."""
_KEPT = 2 * HOP
_SLOWEST = 1.5


class TrialError(ValueError):
    """A trial walk that thresholds cannot be learnt from: the text says why."""


@dataclass(frozen=True, slots=True)
class PersonalThresholds:
    """Local maxima of the norm above δ whose six neighbours' mean is above ρ, 0.33 s apart, in a walk of 2 s or more.

    The state's ``delta`` and ``rho`` are the person's own, or 0.

    Attributes:
        delta: m/s², gravity included, of whom nothing is known.
        rho: the same.
    """

    delta: float = 10.5
    rho: float = 10.1

    STATE = np.dtype(
        [
            ("walk", WalkingDetection.STATE),
            ("norm", np.float64, (_KEPT,)),
            ("last", np.float64),
            ("period", np.float64),
            ("delta", np.float64),
            ("rho", np.float64),
        ]
    )
    """Of one phone: 1 kB."""

    def advance(self, state: State, hops: Hops) -> Steps:
        """Take one hop of each of p phones and return the steps it led to."""
        walk = state["walk"]
        begun = WalkingDetection().advance(walk, hops)
        state["walk"] = walk
        walking = np.isfinite(begun)
        norm = np.sqrt(np.einsum("pni,pni->pn", hops.acceleration, hops.acceleration))
        norm = np.concatenate([state["norm"], norm], axis=1)
        state["norm"] = norm[:, -_KEPT:]
        # What has three samples after it is judged, a confirmed walk from its first second on.
        place = np.arange(HOP - BESIDE, _KEPT + HOP - BESIDE)
        t = hops.t[:, None] + (place - _KEPT) / RATE
        value = norm[:, place]
        sums = np.cumsum(norm, axis=1)
        around = sums[:, place + BESIDE] - sums[:, place - BESIDE - 1]
        delta = np.where(state["delta"] > 0.0, state["delta"], self.delta)[:, None]
        rho = np.where(state["rho"] > 0.0, state["rho"], self.rho)[:, None]
        peaks = (value > norm[:, place - 1]) & (value >= norm[:, place + 1]) & (value > delta)
        peaks &= (around - value) / (2 * BESIDE) > rho
        with np.errstate(invalid="ignore"):
            peaks &= t >= begun[:, None]
        # What the hop before could judge it has judged.
        continued = (place < _KEPT - BESIDE) & (begun < hops.t - 1.5 * HOP / RATE)[:, None]
        phone, index = np.nonzero(peaks & ~continued)
        when = t[phone, index]
        before = state["last"].copy()
        kept = spaced(phone, when, state["last"], np.full(len(state), SPACING))
        phone, when = phone[kept], when[kept]
        count = np.bincount(phone, minlength=len(state))
        interval = (state["last"] - before) / np.maximum(count, 1)
        state["period"] = (
            np.where((count > 0) & (before > 0.0) & (interval < _SLOWEST), interval, state["period"]) * walking
        )
        return Steps(phone, when, walking, state["period"].copy())


def personalise(acceleration: Array, steps: int) -> tuple[float, float]:
    """Return a person's own (δ, ρ), m/s², from the first trial walk.

    All pairs of ``GRID`` with ρ < δ are tried; the centre of those that count the steps exactly is taken, or nearly,
    where none does.

    Args:
        acceleration: (n, 3) m/s², gravity included, at ``RATE``; two seconds or more.
        steps: how many there were, as the person counted, 1 to ``LONGEST_TRIAL`` - 1.

    Raises:
        TrialError: the walk is too long, or no pair counts its steps, or nearly.
    """
    if not 1 <= steps < LONGEST_TRIAL:
        raise TrialError(f"steps: {steps}; a trial walk has 1 to {LONGEST_TRIAL - 1}")
    if len(acceleration) < 2 * HOP:
        raise TrialError(f"samples: {len(acceleration)}; a trial walk takes two seconds or more, {2 * HOP} samples")
    delta, rho = (grid.ravel() for grid in np.meshgrid(GRID, GRID, indexing="ij"))
    possible = np.flatnonzero(rho < delta)
    detector = PersonalThresholds()
    state = np.zeros(len(possible), detector.STATE)
    state["delta"], state["rho"] = delta[possible], rho[possible]
    hops = -(-(len(acceleration) + BESIDE + 1) // HOP)
    padded = np.pad(acceleration, ((0, hops * HOP - len(acceleration)), (0, 0)), mode="edge")
    found = np.zeros(len(possible), np.int64)
    for hop in range(hops):
        samples = padded[hop * HOP : (hop + 1) * HOP]
        told = detector.advance(state, _alike(samples, hop, len(possible)))
        found += np.bincount(told.phone, minlength=len(possible))
    error = np.full(len(delta), np.nan)
    error[possible] = np.abs(found - steps)
    least = float(np.nanmin(error))
    if least > FORGIVEN:
        nearest = int(found[np.argmin(error[possible])])
        raise TrialError(f"steps: {steps}; no thresholds find nearly so many, the nearest find {nearest}")
    row, column = centre_of_zeros((error - least).reshape(len(GRID), len(GRID)))
    return float(GRID[row]), float(GRID[column])


def centre_of_zeros(error: Array) -> tuple[int, int]:
    """Return row and column of the centre of the largest connected region of zeros of ``error`` (n, m).

    That is the cell farthest, in king's moves, from what is not zero, not known (NaN) or outside; of several the one
    nearest to the region's centroid.
    """
    regions, _ = label(error == 0)
    largest = regions == 1 + int(np.argmax(np.bincount(regions.ravel())[1:]))
    depth = distance_transform_cdt(np.pad(largest, 1), metric="chessboard")[1:-1, 1:-1]
    centroid = np.array(center_of_mass(largest))
    deepest: NDArray[np.int64] = np.argwhere(depth == depth.max())
    row, column = deepest[np.argmin(((deepest - centroid) ** 2).sum(axis=1))]
    return int(row), int(column)


def _alike(samples: Array, hop: int, p: int) -> Hops:
    """Return one hop that p phones measured alike."""
    return Hops(
        t=np.full(p, float(hop * HOP / RATE) + 1.0),
        count=np.full(p, HOP),
        fresh=np.full(p, hop == 0),
        acceleration=np.broadcast_to(samples, (p, HOP, 3)),
        rotation=np.zeros((p, HOP, 3)),
        field=np.full((p, HOP, 3), np.nan),
    )
