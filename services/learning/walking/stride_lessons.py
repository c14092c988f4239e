"""How long are somebody's steps? Learned from how far their track went while the phone counted [ravel-thesis §8.3].

The study switches to a person's own line once its R² passes a threshold. Within a walk cadence hardly varies, and then
a perfect line has an R² of nought: what decides here is whether lines learned without a stretch predict that stretch
better than what is in use does, by more than chance. R² is told beside it, and may be asked for on top.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from services.learning.proposal import Proposal
from services.learning.report_draft import ReportDraft
from services.learning.tracks.stretch import Stretch
from services.learning.walking.device_rows import DeviceRows
from services.learning.walking.held_out import LEAST_GROUPS, Gain, gain_of
from services.learning.walking.runs import STEPS, runs_of
from shared.learning_report import ModelKind
from shared.messages import Message, StrideModel
from shared.walking.stride import StrideLine
from shared.walking.stride_learning import fit_line

__all__ = ["StrideLessons", "r_squared"]

Array = NDArray[np.float64]

RUN_SIGMA = 0.035
"""m, of a run's mean step against its person's line: what six worlds of the twin show (0.014–0.045)."""
ALIKE = 2.0
"""Runs of a stretch err alike: so many are worth one."""
LEAST_RUNS, LEAST_STRETCHES = 6, 4
MOST_RUNS = 200
"""Kept of a device: the latest, half an hour of walking in view."""
LEAST_CHANGE = 0.01
"""Of a step's length, below which a new line is not worth a trial."""
FACTORS = (0.5, 2.0)
"""Which fusion allows."""
T, WAY, CADENCE, LENGTH, STRETCH, VERSION = range(6)
"""Columns of what is kept of a run; ``VERSION``: of the line it was published under."""


class StrideLessons:
    """Learns the lines of an area's phones.

    Args:
        area: whose fusion is asked to try a line.
        least_r2: R² a line must have beside its gain; None: any.
    """

    kind: ClassVar[ModelKind] = "stride"

    def __init__(self, area: str, least_r2: float | None = None) -> None:
        self._area = area
        self._least_r2 = least_r2
        self._stretches = 0
        self._known = DeviceRows("stride lessons", 6, MOST_RUNS, StrideModel)

    def learn(self, stretch: Stretch) -> None:
        """Take in how far the track went in each run of steps."""
        runs = runs_of(stretch)
        if not len(runs.t):
            return
        self._stretches += 1
        line = self._known.model(stretch.device)
        version = 0 if line is None or _unknown(line) else line.version
        shared = [np.full(len(runs.t), float(value)) for value in (self._stretches, version)]
        new = np.column_stack([runs.t, runs.way, runs.cadence, runs.length, *shared])
        self._known.keep(stretch.device, np.concatenate([self._known.rows(stretch.device), new]))

    def forget(self, device: str) -> None:
        """Forget a device."""
        self._known.forget(device)

    def propose(self, now: float, until: float) -> Sequence[Proposal]:
        """Return the lines that predict stretches they were not taught by better than what is in use."""
        proposals = (self._propose(device, rows, now, until) for device, rows in self._known.news(until))
        return [proposal for proposal in proposals if proposal is not None]

    def activated(self, model: Message) -> None:
        """Know the line in use."""
        if isinstance(model, StrideModel):
            self._known.activated(model)

    def regret(self, former: Message, since: float) -> tuple[float, float] | None:
        """See ``Critic``; what steps were taken for before any line was live cannot be told afterwards."""
        if not isinstance(former, StrideModel) or self._known.model(former.device) is None or _unknown(former):
            return None
        rows = self._known.rows(former.device)
        rows = rows[rows[:, T] > since]
        if len(np.unique(rows[:, STRETCH])) < LEAST_GROUPS:
            return None
        before = former.slope * rows[:, CADENCE] + former.offset
        ours = self._lengths_in_use(former.device, rows)
        gain = gain_of(rows[:, WAY] - ours, rows[:, WAY] - before, rows[:, STRETCH], RUN_SIGMA)
        return gain.mean, float(gain.margin)

    def lesson(self, device: str) -> dict[str, float | bool | None]:
        """Return what ``DeviceLessons`` tells of a device's steps: slope, offset, r2, steps, used."""
        rows, active = self._known.rows(device), self._known.model(device)
        used = active is not None and not _unknown(active)
        told: dict[str, float | bool | None] = {"steps": STEPS * len(rows), "used": used}
        if len(rows) >= LEAST_RUNS:
            line = _fit(rows)
            told |= {"slope": float(line.slope), "offset": float(line.offset), "r2": r_squared(rows, line)}
        elif active is not None and used:
            told |= {"slope": active.slope, "offset": active.offset}
        return told

    def tell(self, draft: ReportDraft) -> None:
        """Add what is known of each phone."""
        for device in self.devices:
            draft.device(device, **self.lesson(device))

    @property
    def devices(self) -> list[str]:
        """Of whom something is known."""
        return self._known.devices

    def state(self) -> dict[str, Any]:
        """Return runs and lines in use."""
        return {"stretches": self._stretches, "devices": self._known.state()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            ValueError: it is none.
        """
        stretches = state.get("stretches")
        if not isinstance(stretches, int):
            raise ValueError(f"stride lessons: stretches: {stretches!r}; allowed: a number of stretches")
        self._known.restore(state.get("devices", {}))
        self._stretches = stretches

    def _propose(self, device: str, rows: Array, now: float, until: float) -> Proposal | None:
        taught = rows[rows[:, T] <= until]
        if len(taught) < LEAST_RUNS or len(np.unique(taught[:, STRETCH])) < LEAST_STRETCHES:
            return None
        line = _fit(taught)
        active = self._active(device, rows)
        change = float(np.mean(_lengths(line, taught) / self._lengths_in_use(device, taught)) - 1.0)
        gain = _held_out(rows, taught, line, active)
        r2 = r_squared(taught, line)
        if abs(change) < LEAST_CHANGE or not gain.significant or (self._least_r2 is not None and r2 < self._least_r2):
            return None
        factor = float(np.clip(1.0 + change, *FACTORS))
        model = StrideModel(
            t=now,
            device=device,
            version=0,
            slope=float(line.slope),
            offset=float(line.offset),
            scale_variance=float(line.scale_variance),
        )
        steps = STEPS * len(taught)
        return Proposal(
            kind=self.kind,
            subject=device,
            area=self._area,
            model=model,
            trained_until=until,
            question=msgspec.json.encode({"kind": "stride", "scale": {device: factor}}),
            gain=gain.mean,
            margin=gain.margin,
            evidence={
                "steps": float(steps),
                "r2": r2,
                "change": change,
                "step length": float(np.mean(_lengths(line, taught))),
                "error before": gain.before,
                "error after": gain.after,
            },
            reason=(
                f"{steps} steps in view of cameras were {abs(100.0 * change):.0f} % "
                f"{'longer' if change > 0.0 else 'shorter'} than taken for"
            ),
        )

    def _active(self, device: str, rows: Array) -> Array:
        """Return the lengths (n,) the model in use gives n runs; NaN where nobody can tell any more."""
        lengths = self._lengths_in_use(device, rows)
        line = self._known.model(device)
        if line is None or _unknown(line):
            lengths = np.where(rows[:, VERSION] == 0.0, lengths, np.nan)
        return lengths

    def _lengths_in_use(self, device: str, rows: Array) -> Array:
        line = self._known.model(device)
        if line is None or _unknown(line):
            return rows[:, LENGTH]
        return line.slope * rows[:, CADENCE] + line.offset


def r_squared(rows: Array, line: StrideLine) -> float:
    """Return ``1 - SS_res / SS_tot`` of runs (n, 6) [ravel-thesis §8.3]: about nought where cadence does not vary."""
    total = float(np.sum((rows[:, WAY] - rows[:, WAY].mean()) ** 2))
    return 1.0 - float(np.sum((rows[:, WAY] - _lengths(line, rows)) ** 2)) / max(total, 1e-12)


def _held_out(rows: Array, taught: Array, line: StrideLine, active: Array) -> Gain:
    """Return how much better lines are than ``active`` (n,) on stretches that did not teach them.

    What is newer than ``taught`` is predicted by ``line``, any older stretch by a line learned without it.
    """
    predicted = _lengths(line, rows)
    for stretch in np.unique(taught[:, STRETCH]):
        predicted[rows[:, STRETCH] == stretch] = _lengths(
            _fit(taught[taught[:, STRETCH] != stretch]), rows[rows[:, STRETCH] == stretch]
        )
    known = np.isfinite(active)
    way = rows[known, WAY]
    return gain_of(way - active[known], way - predicted[known], rows[known, STRETCH], RUN_SIGMA)


def _fit(rows: Array) -> StrideLine:
    return fit_line(rows[:, CADENCE], rows[:, WAY], RUN_SIGMA, ALIKE)


def _lengths(line: StrideLine, rows: Array) -> Array:
    lengths: Array = line.slope * rows[:, CADENCE] + line.offset
    return lengths


def _unknown(line: StrideModel) -> bool:
    """All zeros: back to what holds for anybody, or what trial walks told."""
    return line.slope == 0.0 and line.offset == 0.0
