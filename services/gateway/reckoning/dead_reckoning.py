"""Where did the phone's steps lead? Inertial samples in, steps with length and heading out, one object per phone."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from services.gateway.reckoning.heading import UNKNOWN_VARIANCE, HeadingFilter, plan_heading
from services.gateway.reckoning.resampling import RATE, Resampler, Segment
from services.gateway.reckoning.stride import USUAL_CADENCE, step_length
from services.gateway.steps.gated_peaks import GatedPeaks, StepDetector

__all__ = ["Activity", "DeadReckoner", "InertialSamples", "Motion"]

Array = NDArray[np.float64]
Activity = Literal["still", "walking", "other"]

REPORT_EVERY = 1.0
MEMORY = int(8.0 * RATE)
"""Samples of heading kept, since steps are released backwards when walking is sure."""
HEADING_WINDOW = 0.5
"""Seconds on either side of a step over which its heading is averaged: one stride of sway cancels."""
STILL_SIGMA = 0.25
"""m/s²: a phone whose acceleration varies less is lying or held still."""


@dataclass(frozen=True, slots=True)
class InertialSamples:
    """Samples in the phone's axes (x right, y to the top, z out of the screen)."""

    t: Array
    """(n,) seconds, phone clock."""
    acceleration: Array
    """(n, 3) m/s², gravity included."""
    rotation: Array
    """(n, 3) rad/s."""
    field: Array | None
    """(n, 3) µT, or None where there is no compass."""


@dataclass(frozen=True, slots=True)
class Motion:
    """What happened between ``t_start`` and ``t``, times on the phone's clock.

    Steps are told once and in order of time; when walking is recognised its first steps lie before the end of the
    report before, and ``t_start`` reaches back to the first of them.
    """

    t_start: float
    t: float
    activity: Activity
    step_t: Array = field(default_factory=lambda: np.empty(0))
    """(n,) seconds."""
    length: Array = field(default_factory=lambda: np.empty(0))
    """(n,) metres."""
    length_variance: Array = field(default_factory=lambda: np.empty(0))
    heading: Array = field(default_factory=lambda: np.empty(0))
    """(n,) radians, counter-clockwise from the plan's +x."""
    heading_variance: Array = field(default_factory=lambda: np.empty(0))


class DeadReckoner:
    """Streaming pedestrian dead reckoning of one phone; about 30 kB of state, no work between pushes.

    Args:
        north: direction of north on the plan, radians counter-clockwise from +x.
        heading_known: False for a phone in a pocket or bag, whose axes say nothing about the walking direction.
        detector: which step detector.
    """

    def __init__(self, north: float, heading_known: bool = True, detector: StepDetector | None = None) -> None:
        self._north = north
        self._heading_known = heading_known
        self._detector: StepDetector = detector or GatedPeaks()
        self._resampler = Resampler()
        self._compass = HeadingFilter()
        self._memory: deque[Array] = deque()
        self._remembered = 0
        self._waiting: list[Array] = []
        self._norms: list[Array] = []
        self._begin: float | None = None
        self._last_step = -np.inf

    @property
    def late(self) -> int:
        """Samples dropped so far because their time had been passed."""
        return self._resampler.late

    def push(self, samples: InertialSamples) -> list[Motion]:
        """Take samples, at any rate and with any jitter; return the reports that are complete, about one a second."""
        columns = [samples.acceleration, samples.rotation]
        if samples.field is not None:
            columns.append(samples.field)
        reports = []
        for segment in self._resampler.push(samples.t, np.concatenate(columns, axis=1)):
            if segment.restarts:
                reports += self._report(self._begin)
                self._restart(float(segment.t[0]))
            self._take(segment)
            if segment.t[-1] - (self._begin or 0.0) >= REPORT_EVERY - 1.5 / RATE:
                reports += self._report(float(segment.t[-1]))
        return reports

    def _restart(self, t: float) -> None:
        self._detector.reset()
        self._compass.reset()
        self._memory.clear()
        self._remembered = 0
        self._begin = t
        self._last_step = -np.inf

    def _take(self, segment: Segment) -> None:
        acceleration, rotation = segment.values[:, :3], segment.values[:, 3:6]
        magnetic = segment.values[:, 6:9] if segment.values.shape[1] == 9 else None
        headings = self._compass.push(acceleration, rotation, magnetic)
        norm = np.linalg.norm(acceleration, axis=1)
        self._memory.append(np.stack([segment.t, headings.heading, headings.variance], axis=1))
        self._remembered += len(norm)
        while self._remembered - len(self._memory[0]) >= MEMORY:
            self._remembered -= len(self._memory.popleft())
        self._norms.append(norm)
        self._waiting.append(self._detector.push(segment.t, norm))

    def _report(self, t: float | None) -> list[Motion]:
        if t is None or self._begin is None or not self._norms:
            return []
        steps, norm = np.concatenate(self._waiting), np.concatenate(self._norms)
        self._waiting, self._norms = [], []
        begin, self._begin = self._begin, t
        if not len(steps):
            activity: Activity = "walking" if self._detector.walking else "other"
            if not self._detector.walking and float(np.std(norm)) < STILL_SIGMA:
                activity = "still"
            return [Motion(begin, t, activity)]
        intervals = np.diff(steps, prepend=self._last_step)
        self._last_step = float(steps[-1])
        usual = self._detector.cadence or USUAL_CADENCE
        cadence = np.where((intervals > 0.2) & (intervals < 1.4), 1.0 / np.maximum(intervals, 0.2), usual)
        length, length_variance = step_length(cadence)
        heading, heading_variance = self._headings_at(steps)
        return [
            Motion(
                t_start=min(begin, float(steps[0])),
                t=t,
                activity="walking",
                step_t=steps,
                length=length,
                length_variance=length_variance,
                heading=plan_heading(heading, self._north),
                heading_variance=heading_variance,
            )
        ]

    def _headings_at(self, steps: Array) -> tuple[Array, Array]:
        memory = np.concatenate(list(self._memory))
        t, heading, variance = memory.T
        ahead = np.concatenate([[0.0], np.cumsum(np.cos(heading))])
        aside = np.concatenate([[0.0], np.cumsum(np.sin(heading))])
        low = np.minimum(np.searchsorted(t, steps - HEADING_WINDOW), len(t) - 1)
        high = np.maximum(np.searchsorted(t, steps + HEADING_WINDOW), low + 1)
        mean = np.arctan2(aside[high] - aside[low], ahead[high] - ahead[low])
        if not self._heading_known:
            return mean, np.full(len(steps), UNKNOWN_VARIANCE)
        return mean, np.interp(steps, t, variance)
