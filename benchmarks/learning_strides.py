"""What would phones have reported of their steps, had the gateway known their owners' stride lines?"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec.structs import replace

from benchmarks.world_record import WorldRecord
from shared.messages import MotionBatch
from shared.walking.stride import StrideLine, step_lengths

__all__ = ["with_strides"]

PAUSE = 1.4
"""Seconds after which a step does not follow the one before."""


def with_strides(record: WorldRecord, lines: Mapping[str, StrideLine]) -> WorldRecord:
    """Return the record with step lengths by the lines of the devices named; others stay as they were."""
    if not lines:
        return record
    motions = {
        device: _paced(messages, lines[device]) if device in lines else list(messages)
        for device, messages in record.motions.items()
    }
    again = {(batch.device, batch.seq): batch for messages in motions.values() for batch in messages}
    arrivals = [
        (t, again[message.device, message.seq] if isinstance(message, MotionBatch) else message)
        for t, message in record.arrivals
    ]
    return dataclasses.replace(record, arrivals=arrivals, motions=motions)


def _paced(batches: Sequence[MotionBatch], line: StrideLine) -> list[MotionBatch]:
    paced: list[MotionBatch] = []
    for batch in batches:
        before = paced[-1] if paced else None
        last = before.step_t[-1] if before and before.step_t and before.walk == batch.walk else np.nan
        interval = np.diff(np.array(batch.step_t), prepend=last)
        with np.errstate(invalid="ignore", divide="ignore"):
            cadence = np.where((interval > 0.0) & (interval <= PAUSE), 1.0 / interval, np.nan)
        steps = step_lengths(cadence, np.full(len(cadence), np.nan), line)
        paced.append(
            replace(
                batch,
                length=steps.length.tolist(),
                length_variance=steps.variance.tolist(),
                length_scale_variance=float(line.scale_variance),
            )
        )
    return paced
