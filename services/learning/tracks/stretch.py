"""One device on one track for up to a minute: what every lesson is drawn from [ravel-thesis §8]."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["SAME", "Stretch"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

SAME = 1e-6
"""Seconds by which times that are the same may differ."""


@dataclass(frozen=True)
class Stretch:
    """A track that bore a device's name, when fusion had thought the name over, and what the phone said meanwhile.

    Times are seconds since the epoch and increase.

    Attributes:
        device: id of the phone.
        track: id of the track.
        t: (n,) when.
        place: (n, 2) metres.
        covariance: (n, 2, 2) m².
        probability: (n,) of the name being right, as fusion said.
        seen: (n,) whether a camera saw the track then (type (a) of the sheet; else (b)).
        sight: (n,) nats by which cameras' detections spoke for the track since the row before (see ``quality``).
        scan_t: (r,) when each reading was taken, one row per scan and access point.
        point: (r,) which access point, a column of the area's list.
        level: (r,) dBm.
        scan_place: (r, 2) where the track was then, metres.
        scan_spread: (r,) standard deviation of that place, metres.
        step_t: (s,) when each step ended.
        length: (s,) m as published, ``length_variance`` m².
        length_variance: (s,) see above.
        heading: (s,) rad, ``heading_variance`` rad².
        heading_variance: (s,) see above.
        walk: (s,) which walk of the phone each step belongs to.
        still: (b, 2) begin and end of the times at which the phone said it stood.
        other: (m,) ids of other tracks that were about, the nearest; in the order of ``other_place``.
        other_t: (k,) when they are told of.
        other_place: (m, k, 2) metres; NaN while a track was not about.
        magnetic: (s,) µT, strength of the magnetic field; NaN where the phone did not tell. May be left empty.
    """

    device: str
    track: int
    t: Array
    place: Array
    covariance: Array
    probability: Array
    seen: NDArray[np.bool_]
    sight: Array
    scan_t: Array
    point: Integers
    level: Array
    scan_place: Array
    scan_spread: Array
    step_t: Array
    length: Array
    length_variance: Array
    heading: Array
    heading_variance: Array
    walk: Integers
    still: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 2)))
    other: Integers = dataclasses.field(default_factory=lambda: np.zeros(0, np.int64))
    other_t: Array = dataclasses.field(default_factory=lambda: np.zeros(0))
    other_place: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 0, 2)))
    magnetic: Array = dataclasses.field(default_factory=lambda: np.empty(0))

    @property
    def seconds(self) -> float:
        """How long it lasted."""
        return float(self.t[-1] - self.t[0])
