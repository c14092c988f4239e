"""What would this camera have detected in the last minutes with other options? A fresh detector on the kept pictures.

The active options are asked about like any others, so that both sides of a comparison saw the same small pictures. A
detector's rates are per second: that fewer pictures are kept than were taken does not favour any.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from services.camera.detector import DetectorError, Image, check_detector
from services.camera.frame_ring import KeptFrame, unpack
from services.camera.pipeline import Pipeline, to_message
from services.camera.projection import aligned
from shared.messages import DetectionFrame
from shared.site import Camera

__all__ = ["Job", "RedetectError", "Redetected", "read_question", "redetect", "reported"]

WARM_UP = 60.0
"""Seconds a detector watches before what it finds is told; a third of the pictures where they are fewer."""
LEAST = 5.0
"""Seconds of told pictures below which there is nothing to compare."""


class RedetectError(ValueError):
    """The question cannot be answered: the text says why and what is allowed."""


class _Question(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    options: dict[str, float] = {}
    since: float | None = None
    until: float | None = None


class Redetected(msgspec.Struct, frozen=True, kw_only=True):
    """The answer: frames as the camera would have published them, from ``since`` to ``until``, and how many a second.

    ``seconds`` is the time they span; ``options`` what was worked with, all of it; ``alignment`` the version of the
    learned correction of the calibration; ``sizes`` how tall and wide people were seen to be, as options, empty while
    too few walked; ``took`` what finding them cost.
    """

    frames: list[DetectionFrame]
    since: float
    until: float
    seconds: float
    rate: float
    options: dict[str, float]
    alignment: int = 0
    sizes: dict[str, float] = {}
    took: float = 0.0


@dataclass(frozen=True)
class Job:
    """One trial.

    Attributes:
        camera: as the site file says.
        floor: its id.
        detector: name of the detector.
        options: all of them that are not the detector's own defaults.
        size: width and height of the pictures as delivered, in whose pixels boxes are told.
        empty: the scene without people, of the size of the kept pictures; None: the detector begins cold.
        since: nothing before this time is told.
        until: nor after.
        homography: (3, 3) learned correction of the plan (``CameraAlignment``), as live detections go through.
        alignment: its version.
        sizes: how tall and wide people were seen to be, as options; told with the answer.
    """

    camera: Camera
    floor: str
    detector: str
    options: Mapping[str, Any]
    size: tuple[int, int]
    empty: Image | None
    since: float
    until: float
    homography: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))
    alignment: int = 0
    sizes: Mapping[str, float] = field(default_factory=dict)


def read_question(
    question: bytes, detector: str, configured: Mapping[str, Any]
) -> tuple[Mapping[str, Any], float | None, float | None]:
    """Return the options, complete, and from when to when (None: whatever is kept).

    Raises:
        RedetectError: it is no such question, or an option is unknown or out of range.
    """
    try:
        asked = msgspec.json.decode(question or b"{}", type=_Question)
        options = {**configured, **asked.options}
        check_detector(detector, options)
    except (msgspec.DecodeError, DetectorError) as error:
        raise RedetectError(str(error)) from error
    if asked.since is not None and asked.until is not None and not asked.since < asked.until:
        raise RedetectError(f"until: found {asked.until:g}; allowed: later than since, {asked.since:g}")
    return options, asked.since, asked.until


def reported(kept: Sequence[KeptFrame], since: float | None, until: float | None) -> tuple[float, float]:
    """Return from when to when detections on these pictures can be told.

    Raises:
        RedetectError: too little is kept.
    """
    if not kept:
        raise RedetectError("too few pictures are kept yet: the camera has just begun, or was set going again")
    first, last = kept[0].t, kept[-1].t
    warm = first + min(WARM_UP, (last - first) / 3.0)
    begin = warm if since is None else max(warm, since)
    end = last if until is None else min(last, until)
    if end - begin < LEAST:
        raise RedetectError(
            f"the pictures kept allow {warm:.3f} … {last:.3f}, of which {max(end - begin, 0.0):.1f} s are asked for; "
            f"allowed: {LEAST:g} s or more"
        )
    return begin, end


def redetect(job: Job, kept: Iterable[KeptFrame]) -> Redetected:
    """Return what a fresh detector finds on the kept pictures, oldest first; nothing later than ``until`` is read."""
    pipeline = Pipeline(job.camera, job.detector, job.options)
    if job.empty is not None:
        pipeline.prime(job.empty)
    frames: list[DetectionFrame] = []
    for frame in kept:
        if frame.t > job.until:
            break
        image = unpack(frame)
        found = aligned(pipeline.process(image, frame.t), job.homography)
        if frame.t < job.since:
            continue
        width, height = job.size
        scale = np.array([width / image.shape[1], height / image.shape[0]])
        found.boxes[:] *= np.concatenate([scale, scale])
        frames.append(to_message(job.camera.id, job.floor, len(frames), frame.t, found))
    seconds = frames[-1].t - frames[0].t if frames else 0.0
    return Redetected(
        frames=frames,
        since=job.since,
        until=job.until,
        seconds=seconds,
        rate=(len(frames) - 1) / seconds if seconds > 0.0 else 0.0,
        options=pipeline.options,
        alignment=job.alignment,
        sizes=dict(job.sizes),
    )
