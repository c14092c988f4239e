"""What the study did to its recordings to see when a method fails [ravel-thesis §12.1], done to a record of the twin.

Each function returns a new record; the truth stays as it is. Whoever draws is given the generator.
"""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from collections.abc import Callable, Sequence

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from benchmarks.world_record import Truth, WorldRecord
from shared.messages import DetectionFrame, MotionBatch, RadioScan

__all__ = ["Rectangle", "accompanied", "crowded", "cut", "occluded", "random_rectangle", "thinned", "turned"]

Array = NDArray[np.float64]
Rectangle = tuple[float, float, float, float]
"""left, lower, right, upper; metres."""


def random_rectangle(view: Array, share: float, rng: np.random.Generator) -> Rectangle:
    """Return a rectangle of a share of what a camera sees, shaped like that and somewhere within it.

    Args:
        view: (c, 2) corners of the floor in view, metres.
        share: of its bounding box's area, 0 to 1.
        rng: draws the place.
    """
    low, high = view.min(axis=0), view.max(axis=0)
    size = math.sqrt(share) * (high - low)
    left, lower = low + rng.random(2) * (high - low - size)
    return float(left), float(lower), float(left + size[0]), float(lower + size[1])


def occluded(record: WorldRecord, hidden: Rectangle) -> WorldRecord:
    """Return the record with every detection inside a rectangle deleted."""
    left, lower, right, upper = hidden

    def without(frame: DetectionFrame) -> DetectionFrame:
        seen = [not (left <= x <= right and lower <= y <= upper) for x, y in zip(frame.x, frame.y, strict=True)]
        return frame if all(seen) else _chosen(frame, np.flatnonzero(seen).tolist())

    return _with_frames(record, without)


def crowded(record: WorldRecord, shifts: Sequence[float]) -> WorldRecord:
    """Return the record with what its cameras saw later pasted into every frame as well.

    Args:
        record: of one area; after its end its beginning follows.
        shifts: seconds into the future, one per layer of people pasted.
    """
    of_camera: dict[str, list[DetectionFrame]] = defaultdict(list)
    for frame in record.frames:
        of_camera[frame.camera].append(frame)
    times = {camera: np.array([frame.t for frame in frames]) for camera, frames in of_camera.items()}

    def joined(frame: DetectionFrame) -> DetectionFrame:
        t = times[frame.camera]
        span = t[-1] - t[0]
        for shift in shifts:
            wanted = t[0] + (frame.t - t[0] + shift) % span if span > 0.0 else t[0]
            later = of_camera[frame.camera][int(np.argmin(np.abs(t - wanted)))] if span > 0.0 else frame
            frame = _both(frame, later)
        return frame

    return _with_frames(record, joined)


def accompanied(record: WorldRecord, shifts: Sequence[float]) -> WorldRecord:
    """Return the record with later people pasted in together with their phones, as devices of their own.

    For measuring time: nobody's truth is known of the people pasted. Phones fall silent ``shift`` seconds before the
    record's end.
    """
    begin = record.truth.t[0]
    arrivals = list(crowded(record, shifts).arrivals)
    for number, shift in enumerate(shifts, start=1):
        arrivals += [
            (t - shift, _moved(message, -shift, number))
            for t, message in record.arrivals
            if not isinstance(message, DetectionFrame) and t - shift >= begin
        ]
    return _with_arrivals(record, sorted(arrivals, key=lambda arrival: arrival[0]))


def turned(record: WorldRecord, low: float, high: float, rng: np.random.Generator) -> WorldRecord:
    """Return the record with an error added to the heading of every step, which nobody is told of.

    Args:
        record: of one area.
        low: degrees; each step's error is drawn evenly between ``low`` and ``high``, to one side for each device.
        high: degrees.
        rng: draws sides and errors.
    """
    sides = {device: rng.choice([-1.0, 1.0]) for device in sorted(record.motions)}

    def wrong(message: DetectionFrame | RadioScan | MotionBatch) -> DetectionFrame | RadioScan | MotionBatch:
        if not isinstance(message, MotionBatch):
            return message
        error = sides[message.device] * np.radians(rng.uniform(low, high, len(message.heading)))
        other = (np.array(message.other_heading) + error).tolist() if message.other_heading else []
        return replace(message, heading=(np.array(message.heading) + error).tolist(), other_heading=other)

    return _with_arrivals(record, [(t, wrong(message)) for t, message in record.arrivals])


def thinned(record: WorldRecord, every: int) -> WorldRecord:
    """Return the record with one in ``every`` frames of each camera."""
    count: dict[str, int] = defaultdict(int)
    kept = set()
    for frame in record.frames:
        if count[frame.camera] % every == 0:
            kept.add((frame.camera, frame.t))
        count[frame.camera] += 1
    return _with_arrivals(
        record,
        [
            (t, message)
            for t, message in record.arrivals
            if not isinstance(message, DetectionFrame) or (message.camera, message.t) in kept
        ],
    )


def cut(record: WorldRecord, seconds: float) -> WorldRecord:
    """Return the first ``seconds`` of a record."""
    end = record.truth.t[0] + seconds
    short = _with_arrivals(record, [arrival for arrival in record.arrivals if arrival[0] < end])
    told = record.truth.t < end
    truth = record.truth
    return dataclasses.replace(
        short, truth=Truth(truth.t[told], truth.person, truth.device, truth.position[told], truth.in_view[told])
    )


def _chosen(frame: DetectionFrame, places: Sequence[int]) -> DetectionFrame:
    return replace(frame, **{name: [getattr(frame, name)[place] for place in places] for name in frame.columns()})


def _both(frame: DetectionFrame, other: DetectionFrame) -> DetectionFrame:
    return replace(frame, **{name: getattr(frame, name) + getattr(other, name) for name in frame.columns()})


def _moved(message: RadioScan | MotionBatch, by: float, number: int) -> RadioScan | MotionBatch:
    device = f"{message.device}-{number}"
    if isinstance(message, RadioScan):
        return replace(message, t=message.t + by, device=device)
    return replace(
        message,
        t=message.t + by,
        t_start=message.t_start + by,
        device=device,
        step_t=[t + by for t in message.step_t],
        turn_t=[t + by for t in message.turn_t],
        revises_from=None if message.revises_from is None else message.revises_from + by,
    )


def _with_frames(record: WorldRecord, change: Callable[[DetectionFrame], DetectionFrame]) -> WorldRecord:
    return _with_arrivals(
        record,
        [(t, change(message) if isinstance(message, DetectionFrame) else message) for t, message in record.arrivals],
    )


def _with_arrivals(
    record: WorldRecord, arrivals: Sequence[tuple[float, DetectionFrame | RadioScan | MotionBatch]]
) -> WorldRecord:
    """Return the record with other arrivals, and everything that repeats them."""
    frames = [message for _, message in arrivals if isinstance(message, DetectionFrame)]
    scans: dict[str, list[RadioScan]] = {device: [] for device in record.scans}
    motions: dict[str, list[MotionBatch]] = {device: [] for device in record.motions}
    for _, message in arrivals:
        if isinstance(message, RadioScan):
            scans.setdefault(message.device, []).append(message)
        elif isinstance(message, MotionBatch):
            motions.setdefault(message.device, []).append(message)
    return dataclasses.replace(
        record,
        arrivals=arrivals,
        frames=sorted(frames, key=lambda frame: (frame.t, frame.camera)),
        scans={device: sorted(said, key=lambda message: message.t) for device, said in scans.items()},
        motions={device: sorted(said, key=lambda message: message.t) for device, said in motions.items()},
    )
