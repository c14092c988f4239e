"""What did a phone feel while feet truly stepped? The Oxford step counter recordings, their truth repaired.

Oxford step counter data set, CC BY 4.0: 33 walks of 3 people with a phone in the hand, a pocket or a purse, and
switches under both feet.
"""

from __future__ import annotations

import gzip
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.gateway.reckoning.hops import HOP, RATE, Hops
from services.gateway.steps.detector import LONGEST_DELAY, StepDetector
from shared.settings import data_folder

__all__ = [
    "LAGS",
    "MATCHED_WITHIN",
    "POSITIONS",
    "Recording",
    "best_lag",
    "detect",
    "found_steps",
    "hops_of",
    "matched_steps",
    "matches_by_lag",
    "middle_lag",
    "read_recordings",
]

Array = NDArray[np.float64]

POSITIONS = {"InHand": "hand", "FrontPocket": "front", "BackPocket": "back", "Purse": "purse"}
"""Where the phone was, by its name in the data set."""

MATCHED_WITHIN = 0.25
"""Seconds between a step found and the true one."""
LAGS = np.arange(-10, 11) * 0.04
"""Seconds by which steps found may be shifted before they are matched."""
_TOO_SOON, _HOLE = 0.6, (1.6, 3.4)
"""Of a median stride: edges of one foot nearer than this are one; holes of two or three strides were walked."""


@dataclass(frozen=True, slots=True)
class Recording:
    """One walk.

    Attributes:
        name: of its folder.
        person: who walked.
        position: where the phone was, a value of ``POSITIONS``.
        t: s of the first sample since the recording began.
        acceleration: (n, 3) m/s², gravity included, phone axes, at ``RATE``; n is whole hops and a little.
        steps: (k,) s, when a foot struck.
    """

    name: str
    person: str
    position: str
    t: float
    acceleration: Array
    steps: Array

    @property
    def end(self) -> float:
        """Time of the last sample, s."""
        return self.t + (len(self.acceleration) - 1) / RATE

    def outside(self) -> float:
        """Return the seconds before the first step and after the last: handling, where there is any."""
        return float(max(0.0, self.steps[0] - self.t) + max(0.0, self.end - self.steps[-1]))


def read_recordings(data: Path | None = None, names: Sequence[str] | None = None) -> list[Recording]:
    """Return the recordings called ``names``, by default all, in order of their names."""
    folder = (data or data_folder()) / "step-counter" / "optimisation" / "data"
    return [_read(path) for path in sorted(folder.iterdir()) if path.is_dir() and (names is None or path.name in names)]


def hops_of(recordings: Sequence[Recording]) -> Iterator[Hops]:
    """Yield hop after hop of all recordings side by side, each followed by rest so that late steps are told too.

    None of them has gyroscope or compass.
    """
    longest = max(len(recording.acceleration) for recording in recordings)
    hops = -(-longest // HOP) + int(np.ceil(LONGEST_DELAY * RATE / HOP)) + 1
    held = np.stack(
        [np.pad(r.acceleration, ((0, hops * HOP - len(r.acceleration)), (0, 0)), mode="edge") for r in recordings]
    )
    begin = np.array([recording.t for recording in recordings])
    p = len(recordings)
    for hop in range(hops):
        yield Hops(
            t=begin + hop * HOP / RATE,
            count=np.full(p, HOP),
            fresh=np.full(p, hop == 0),
            acceleration=held[:, hop * HOP : (hop + 1) * HOP],
            rotation=np.zeros((p, HOP, 3)),
            field=np.full((p, HOP, 3), np.nan),
        )


def detect(
    detector: StepDetector, recordings: Sequence[Recording], state: NDArray[np.void] | None = None
) -> list[Array]:
    """Return the steps found in each recording, s; ``state`` (p,) may hold what is known of each person."""
    return found_steps(detector, hops_of(recordings), recordings, state)


def found_steps(
    detector: StepDetector,
    hops: Iterator[Hops],
    recordings: Sequence[Recording],
    state: NDArray[np.void] | None = None,
) -> list[Array]:
    """As ``detect``, from hops made before."""
    state = np.zeros(len(recordings), detector.STATE) if state is None else state
    found: list[list[Array]] = [[] for _ in recordings]
    for hop in hops:
        steps = detector.advance(state, hop)
        for phone in np.unique(steps.phone):
            found[phone].append(steps.t[steps.phone == phone])
    every = [np.concatenate(parts) if parts else np.empty(0) for parts in found]
    return [t[t <= recording.end] for t, recording in zip(every, recordings, strict=True)]


def matches_by_lag(found: Array, true: Array) -> Array:
    """Return how many steps found are matched when shifted by each of ``LAGS``."""
    return np.array([matched_steps(found + lag, true) for lag in LAGS], float)


def best_lag(found: Array, true: Array) -> float:
    """Return the one lag, s, at which most steps found are matched.

    Detectors mark different moments of a step and the switches were polled at 10 Hz, so a recording has one lag.
    """
    return middle_lag(matches_by_lag(found, true))


def middle_lag(pairs: Array) -> float:
    """Return the middle one of the lags with most matches, s, given how many there are at each of ``LAGS``."""
    best = np.flatnonzero(pairs == pairs.max())
    return float(LAGS[best[len(best) // 2]])


def matched_steps(found: Array, true: Array) -> int:
    """Return how many steps found can be matched with true ones within ``MATCHED_WITHIN``, each used once."""
    pairs = begin = 0
    for t in found.tolist():
        while begin < len(true) and true[begin] < t - MATCHED_WITHIN:
            begin += 1
        if begin < len(true) and true[begin] <= t + MATCHED_WITHIN:
            pairs += 1
            begin += 1
    return pairs


def _read(folder: Path) -> Recording:
    _, person, _, position, _ = folder.name.split("_")
    samples, feet = (_table(folder / f"{name}.csv.gz") for name in ("accelerometer", "stepcounter"))
    begin = samples[0, 0]
    samples[:, 0] = (samples[:, 0] - begin) * 1e-9
    bins = np.floor(samples[:, 0] * RATE).astype(np.int64)
    count = np.bincount(bins)
    there = np.flatnonzero(count)
    even = np.arange(len(count))
    axes = [np.interp(even, there, np.bincount(bins, weights=axis)[there] / count[there]) for axis in samples[:, 2:5].T]
    feet_t = (feet[:, 0] - begin) * 1e-9
    steps = np.concatenate([_repaired(feet_t[1:][np.diff(feet[:, foot]) > 0]) for foot in (1, 2)])
    return Recording(folder.name, person, POSITIONS[position], 0.5 / RATE, np.stack(axes, axis=1), np.sort(steps))


def _repaired(edges: Array) -> Array:
    """Return one foot's strikes (k,) s: bounces of the switch dropped, single strides that it missed filled in."""
    stride = float(np.median(np.diff(edges)))
    kept = [edges[0]]
    for edge in edges[1:]:
        gap = edge - kept[-1]
        if gap < _TOO_SOON * stride:
            continue
        if _HOLE[0] * stride < gap < _HOLE[1] * stride:
            parts = round(gap / stride)
            kept += [kept[-1] + gap * part / parts for part in range(1, parts)]
        kept.append(edge)
    return np.array(kept)


def _table(path: Path) -> Array:
    with gzip.open(path, "rt", encoding="ascii") as lines:
        return np.loadtxt(lines, delimiter=",", dtype=np.float64)
