"""By how much are a phone's headings turned? Learned from the way of the tracks it was on [ravel-thesis §8.3].

A phone is held at an angle, its compass is bent, and which angle it is differs from walk to walk by ten degrees. What
may be taken off its headings is what the walks have in common; what is left from walk to walk is told as variance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from services.learning.proposal import Proposal
from services.learning.report_draft import ReportDraft
from services.learning.tracks.stretch import Stretch
from services.learning.walking.device_rows import DeviceRows
from services.learning.walking.held_out import LEAST_GROUPS, gain_of
from services.learning.walking.runs import runs_of
from shared.learning_report import ModelKind
from shared.messages import HeadingModel, Message

__all__ = ["Bias", "HeadingLessons", "bias_of"]

Array = NDArray[np.float64]

USUAL_SIGMA = math.radians(12.0)
"""Of what the walks of one phone have in common, from phone to phone."""
WALK_SIGMA = math.radians(10.0)
"""Of one walk against the others of its phone, before any are known; so sure as ``WALK_BELIEF`` walks."""
WALK_BELIEF = 4.0
FLIPPED = math.radians(75.0)
"""Beyond it a phone's heading is that of the wrong side of a pocket, or the track somebody else's: no bias."""
PAUSE = 120.0
"""Seconds; gateways that start anew count walks anew."""
MIXED = 300.0
"""Seconds before a model went live: stretches of that time are told later, nobody knows under which model."""
LEAST_WALKS = 5
MOST_WALKS = 60
LEAST_CHANGE = math.radians(2.0)
HUBER = 1.5
T, COSINE, SINE, RUNS, WALK = range(5)
"""Columns of what is kept of a walk: when it was last seen, sums of unit vectors of its runs, how many, its number."""


class Bias(msgspec.Struct, frozen=True):
    """What walks of a phone have in common.

    Attributes:
        mean: radians.
        variance: rad², of another walk about ``mean``; ``error`` rad² of ``mean`` is part of it.
        error: see above.
    """

    mean: float
    variance: float
    error: float


class HeadingLessons:
    """Learns by how much an area's phones are turned.

    Args:
        area: whose tracks teach.
    """

    kind: ClassVar[ModelKind] = "heading"

    def __init__(self, area: str) -> None:
        self._area = area
        self._known = DeviceRows("heading lessons", 5, MOST_WALKS, HeadingModel)

    def learn(self, stretch: Stretch) -> None:
        """Take in how its runs of steps were turned against the track."""
        runs = runs_of(stretch)
        known = np.isfinite(runs.turned) & (np.abs(runs.turned) < FLIPPED)
        model = self._known.model(stretch.device)
        if model is not None:
            known &= (runs.t >= model.t) | (runs.t < model.t - MIXED)
        if not known.any():
            return
        taken_off = 0.0 if model is None else model.bias
        rows = self._known.rows(stretch.device).copy()
        for t, turned, walk in zip(runs.t[known], runs.turned[known] + taken_off, runs.walk[known], strict=True):
            new = np.array([t, math.cos(turned), math.sin(turned), 1.0, float(walk)])
            if len(rows) and rows[-1, WALK] == walk and t - rows[-1, T] < PAUSE:
                new[[COSINE, SINE, RUNS]] += rows[-1, [COSINE, SINE, RUNS]]
                rows[-1] = new
            else:
                rows = np.vstack([rows, new])
        self._known.keep(stretch.device, rows)

    def forget(self, device: str) -> None:
        """Forget a device."""
        self._known.forget(device)

    def propose(self, now: float, until: float) -> Sequence[Proposal]:
        """Return the biases which, learned without a walk, make that walk's headings better."""
        proposals = (self._propose(device, rows, now, until) for device, rows in self._known.news(until))
        return [proposal for proposal in proposals if proposal is not None]

    def activated(self, model: Message) -> None:
        """Know what is taken off."""
        if isinstance(model, HeadingModel):
            self._known.activated(model)

    def regret(self, former: Message, since: float) -> tuple[float, float] | None:
        """See ``Critic``: by how much walks since would rather have had the bias before taken off."""
        model = self._known.model(former.device) if isinstance(former, HeadingModel) else None
        if model is None or not isinstance(former, HeadingModel):
            return None
        rows = self._known.rows(model.device)
        angles = _angles(rows[rows[:, T] > since])
        if len(angles) < LEAST_GROUPS:
            return None
        ours, theirs = _wrapped(angles - model.bias), _wrapped(angles - former.bias)
        gain = gain_of(ours, theirs, np.arange(len(angles)), math.sqrt(model.variance))
        return gain.mean, float(gain.margin)

    def lesson(self, device: str) -> dict[str, float | None]:
        """Return what ``DeviceLessons`` tells of a device's headings: heading_bias, heading_error."""
        rows = self._known.rows(device)
        if len(rows) < LEAST_WALKS:
            return {"heading_bias": None, "heading_error": None}
        found = bias_of(_angles(rows), rows[:, RUNS])
        return {"heading_bias": found.mean, "heading_error": math.sqrt(found.error)}

    def tell(self, draft: ReportDraft) -> None:
        """Add what is known of each phone."""
        for device in self.devices:
            draft.device(device, **self.lesson(device))

    @property
    def devices(self) -> list[str]:
        """Of whom something is known."""
        return self._known.devices

    def state(self) -> dict[str, Any]:
        """Return walks and models in use."""
        return {"devices": self._known.state()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            ValueError: it is none.
        """
        self._known.restore(state.get("devices", {}))

    def _propose(self, device: str, rows: Array, now: float, until: float) -> Proposal | None:
        taught = rows[:, T] <= until
        if taught.sum() < LEAST_WALKS:
            return None
        angles, runs = _angles(rows), rows[:, RUNS]
        found = bias_of(angles[taught], runs[taught])
        model = self._known.model(device)
        active = 0.0 if model is None else model.bias
        predicted = np.full(len(rows), found.mean)
        for row in np.flatnonzero(taught):
            others = taught.copy()
            others[row] = False
            predicted[row] = bias_of(angles[others], runs[others]).mean
        sigma = math.sqrt(found.variance)
        gain = gain_of(_wrapped(angles - active), _wrapped(angles - predicted), np.arange(len(rows)), sigma)
        change = float(_wrapped(np.array(found.mean - active)))
        if abs(change) < LEAST_CHANGE or not gain.significant:
            return None
        return Proposal(
            kind=self.kind,
            subject=device,
            area=self._area,
            model=HeadingModel(t=now, device=device, version=0, bias=found.mean, variance=found.variance),
            trained_until=until,
            gain=gain.mean,
            margin=gain.margin,
            evidence={
                "walks": float(taught.sum()),
                "bias": found.mean,
                "error before": gain.before,
                "error after": gain.after,
            },
            reason=(
                f"in {int(taught.sum())} walks the phone's headings were turned by {math.degrees(found.mean):.0f}° "
                "against the way its carrier went"
            ),
        )


def bias_of(angles: Array, runs: Array) -> Bias:
    """Return what walks have in common: a robust mean, drawn towards nought, and what is left from walk to walk.

    Args:
        angles: (n,) radians, each the mean of one walk.
        runs: (n,) of how many runs.
    """
    scatter = WALK_SIGMA**2
    weight = runs / (runs + 1.0)  # a run alone errs by as much again as walks differ
    robust = np.ones(len(angles))
    mean = error = 0.0
    for _ in range(10):
        information = float((robust * weight).sum()) / scatter + USUAL_SIGMA**-2
        start = math.atan2(float(robust @ np.sin(angles)), float(robust @ np.cos(angles))) if len(angles) else 0.0
        mean = float((robust * weight) @ (start + _wrapped(angles - start))) / scatter / information
        error = 1.0 / information
        off = _wrapped(angles - mean)
        robust = np.minimum(1.0, HUBER * math.sqrt(scatter) / np.maximum(np.abs(off), 1e-9))
        squares = float((robust * weight * off**2).sum()) + WALK_BELIEF * WALK_SIGMA**2
        scatter = squares / (float((robust * weight).sum()) + WALK_BELIEF)
    return Bias(float(mean), float(scatter + error), float(error))


def _angles(rows: Array) -> Array:
    angles: Array = np.arctan2(rows[:, SINE], rows[:, COSINE])
    return angles


def _wrapped(angles: Array) -> Array:
    wrapped: Array = np.angle(np.exp(1j * angles))
    return wrapped
