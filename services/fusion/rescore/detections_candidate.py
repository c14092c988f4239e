"""What cameras would have detected with other settings, as it is asked about.

``{"kind": "detections", "frames": {CAMERA: [DetectionFrame]}, "active": {CAMERA: [DetectionFrame]}}``. ``active`` is
what they would have detected in the same pictures with the settings they have; left out, what they did detect counts,
which is fair only where those were the same pictures, as many and as large.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from services.fusion.area_view import AreaView
from services.fusion.rescore.radio_candidate import CandidateError, Windowed
from services.fusion.rescore.setting import Asked, Setting
from shared.messages import DetectionFrame

__all__ = ["DetectionsCandidate", "with_detections"]


class DetectionsCandidate(Windowed, frozen=True, kw_only=True, tag_field="kind", tag="detections"):
    """Other detections of the last minutes' pictures."""

    frames: dict[str, list[DetectionFrame]]
    active: dict[str, list[DetectionFrame]] = {}


def with_detections(asked: DetectionsCandidate, view: AreaView) -> Asked:
    """Return both sides of the trial; it is judged where all these cameras were looked at anew.

    Raises:
        CandidateError: naming the field, the value found and what is allowed.
    """
    if not asked.frames:
        raise CandidateError("frames: found nothing; allowed: camera ids, each with its frames")
    _check("frames", asked.frames, view)
    _check("active", asked.active, view)
    if asked.active:
        for camera, seen in asked.frames.items():
            found = len(asked.active.get(camera, ()))
            if found != len(seen):
                raise CandidateError(
                    f"active.{camera}: found {found} frames; allowed: as many as in frames, {len(seen)}"
                )
    since = max(seen[0].t for seen in asked.frames.values())
    until = math.nextafter(min(seen[-1].t for seen in asked.frames.values()), math.inf)
    return Asked(Setting(view, frames=asked.active), Setting(view, frames=asked.frames), since, until, sight=True)


def _check(field: str, frames: Mapping[str, Sequence[DetectionFrame]], view: AreaView) -> None:
    for camera, seen in frames.items():
        where = f"{field}.{camera}"
        if camera not in view.views:
            allowed = ", ".join(sorted(view.views)) or "none"
            raise CandidateError(f"{where}: no camera of area {view.area}; allowed: {allowed}")
        if len(seen) < 2:
            raise CandidateError(f"{where}: found {len(seen)} frames; allowed: 2 or more")
        for number, frame in enumerate(seen):
            if (frame.camera, frame.floor) != (camera, view.floor):
                found = f"{frame.camera!r} on floor {frame.floor!r}"
                raise CandidateError(f"{where}[{number}]: found {found}; allowed: {camera!r} on floor {view.floor!r}")
            if number and not frame.t > seen[number - 1].t:
                raise CandidateError(f"{where}[{number}].t: found {frame.t}; allowed: later than the frame before")
