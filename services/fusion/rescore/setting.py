"""What a tracker runs under in a trial: another radio, other step lengths, other detections of the same pictures."""

from __future__ import annotations

import dataclasses
import math
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from services.fusion.area_view import AreaView
from services.fusion.tracker import Chunk
from shared.messages import DetectionFrame, MotionBatch
from shared.walking.stride import StrideLine, step_lengths

__all__ = ["Asked", "Setting", "under"]

APART = 1.5
"""Seconds between two steps of one walk, at most."""


@dataclasses.dataclass(frozen=True)
class Setting:
    """One of the two sides of a trial.

    Attributes:
        view: the area, with the radio of this side.
        scale: factor of devices' published step lengths.
        lines: slope (m per step/s) and offset (m) by which devices' steps are reckoned anew from their cadence.
        frames: by camera, in order of time, what takes the place of its frames from the first to the last of them.
    """

    view: AreaView
    scale: Mapping[str, float] = dataclasses.field(default_factory=dict)
    lines: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    frames: Mapping[str, Sequence[DetectionFrame]] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Asked:
    """A question, checked.

    Attributes:
        active: what is.
        candidate: what might be; None: only the active side is scored.
        since: seconds since the epoch; only what was withheld from then on …
        until: … and before this time is scored.
        sight: whether what cameras say of the tracks is scored too.
    """

    active: Setting
    candidate: Setting | None = None
    since: float = -math.inf
    until: float = math.inf
    sight: bool = False


def under(setting: Setting, chunks: Sequence[Chunk]) -> list[Chunk]:
    """Return the chunks as they would have been."""
    changed = list(chunks)
    if setting.scale or setting.lines:
        last: dict[str, float] = {}
        for number, chunk in enumerate(changed):
            motions = tuple(_walked(batch, setting, last) for batch in chunk.motions)
            changed[number] = dataclasses.replace(chunk, motions=motions)
    if setting.frames and changed:
        changed = _seen(changed, setting.frames)
    return changed


def _walked(batch: MotionBatch, setting: Setting, last: dict[str, float]) -> MotionBatch:
    """Return a batch with the lengths of this side; ``last`` is when each device's last step ended."""
    if not batch.step_t:
        return batch
    length = np.array(batch.length)
    changed = setting.scale.get(batch.device, 1.0) * length
    if batch.device in setting.lines:
        before = last.get(batch.device, -math.inf)
        interval = np.diff(np.array([before, *batch.step_t]))
        cadence = np.full(len(interval), np.nan)
        known = (interval > 0.0) & (interval <= APART)
        cadence[known] = 1.0 / interval[known]
        slope, offset = (np.array(value) for value in setting.lines[batch.device])
        unheard = np.full(len(cadence), np.nan)
        changed = step_lengths(cadence, unheard, StrideLine(slope, offset, np.array(0.0))).length
        last[batch.device] = batch.step_t[-1]
    factor = np.where(length > 0.0, changed / np.maximum(length, 1e-9), 1.0)
    variance = factor**2 * np.array(batch.length_variance)
    return msgspec.structs.replace(batch, length=changed.tolist(), length_variance=variance.tolist())


def _seen(chunks: Sequence[Chunk], frames: Mapping[str, Sequence[DetectionFrame]]) -> list[Chunk]:
    span = {camera: (seen[0].t, seen[-1].t) for camera, seen in frames.items()}
    ends = [chunk.t_end for chunk in chunks]
    given: dict[int, list[DetectionFrame]] = defaultdict(list)
    for seen in frames.values():
        for frame in seen:
            number = bisect_right(ends, frame.t)
            if number < len(chunks) and frame.t >= chunks[0].t_start:
                given[number].append(frame)
    changed = []
    for number, chunk in enumerate(chunks):
        kept = [frame for frame in chunk.frames if not _within(frame, span)]
        both = sorted(kept + given[number], key=lambda frame: (frame.t, frame.camera))
        changed.append(dataclasses.replace(chunk, frames=tuple(both)))
    return changed


def _within(frame: DetectionFrame, span: Mapping[str, tuple[float, float]]) -> bool:
    first, last = span.get(frame.camera, (math.inf, -math.inf))
    return first <= frame.t <= last
