"""How long were somebody's steps really, and how far off is a line? Truth of a record, for scoring what was learned."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.world_record import WorldRecord
from shared.messages import StrideModel

__all__ = ["stride_error", "true_steps"]

Array = NDArray[np.float64]

STEPS = 6
INTERVALS = (0.3, 1.0)
"""Seconds between which a step follows the one before it."""
LEAST_WAY = 1.5
"""Metres of ``STEPS`` steps; who goes less far treads on the spot."""


def true_steps(record: WorldRecord, device: str) -> tuple[Array, Array, Array]:
    """Return cadence (n,) steps/s, true and published mean length (n,) m of all runs of six steps of a phone.

    Steps are those the gateway told: a step it missed makes the others longer, as it does for whoever adds them up.
    """
    person = list(record.truth.device).index(device)
    place = record.truth.position[:, person]
    known = np.isfinite(place[:, 0])
    way = np.concatenate([[0.0], np.cumsum(np.nan_to_num(np.hypot(*np.diff(place, axis=0).T)))])
    steps = [row for batch in record.motions[device] for row in zip(batch.step_t, batch.length, strict=True)]
    step_t, length = np.array(sorted(steps), float).reshape(-1, 2).T
    walked = np.interp(step_t, record.truth.t, way)
    here = known[np.clip(np.searchsorted(record.truth.t, step_t), 0, len(known) - 1)]
    apart = np.diff(step_t)
    follows = (apart > INTERVALS[0]) & (apart < INTERVALS[1]) & here[1:] & here[:-1]
    rows: list[tuple[float, float, float]] = []
    first = 0
    while first + STEPS < len(step_t):
        run = slice(first, first + STEPS)
        far = float(walked[first + STEPS] - walked[first])
        if follows[run].all() and far > LEAST_WAY:
            told = float(length[first + 1 : first + STEPS + 1].mean())
            rows.append((float(np.mean(1.0 / apart[run])), far / STEPS, told))
            first += STEPS
        else:
            first += 1
    cadence, true, published = np.array(rows, float).reshape(-1, 3).T
    return cadence, true, published


def stride_error(model: StrideModel, record: WorldRecord) -> tuple[float, float]:
    """Return by what share a line, and what was published, is longer than the true step of its person, in the mean."""
    cadence, true, published = true_steps(record, model.device)
    if not len(true):
        return float("nan"), float("nan")
    line = float(np.mean(model.slope * cadence + model.offset))
    return line / float(true.mean()) - 1.0, float(published.mean() / true.mean()) - 1.0
