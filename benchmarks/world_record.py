"""What an off-line experiment works on: everything the sensors of one area said, and the truth, as plain values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.messages import DetectionFrame, MotionBatch, RadioScan
from shared.site import Site

__all__ = ["Truth", "WorldRecord"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Truth:
    """Where everybody really was, on one floor, at regular times.

    Attributes:
        t: (n,) seconds since the epoch.
        person: p ids.
        device: p device ids; None for who carries none.
        position: (n, p, 2) metres; NaN while the person is not about.
        in_view: (n, p) whether the person stood where a camera of the area looks (occluded or not).
    """

    t: Array
    person: Sequence[str]
    device: Sequence[str | None]
    position: Array
    in_view: NDArray[np.bool_]

    def carriers(self) -> list[int]:
        """Return the places in ``person`` of who carries a device."""
        return [place for place, device in enumerate(self.device) if device is not None]


@dataclass(frozen=True, slots=True)
class WorldRecord:
    """One area of one run.

    Attributes:
        site: the site as its trackers know it (the world's own radio constants differ).
        area: id of the area whose cameras these are.
        arrivals: when (seconds since the epoch) each message reached the bus and what it said, in order of arrival:
            frames of its cameras, scans and motion reports of all devices. What a live run would consume.
        frames: what its cameras published, in order of measurement.
        scans: by device, radio scans with site ids of access points, in order of measurement.
        motions: by device, what the gateway made of the inertial samples, in order of measurement.
        truth: for scoring only.
        view: corners (c, 2) in metres of the floor the cameras see (convex hull).
    """

    site: Site
    area: str
    arrivals: Sequence[tuple[float, DetectionFrame | RadioScan | MotionBatch]]
    frames: Sequence[DetectionFrame]
    scans: Mapping[str, Sequence[RadioScan]]
    motions: Mapping[str, Sequence[MotionBatch]]
    truth: Truth
    view: Array
