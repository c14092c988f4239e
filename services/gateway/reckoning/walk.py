"""What is remembered of one phone's walk? And what dead reckoning tells of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from services.gateway.reckoning.calibration import Calibration
from services.gateway.reckoning.carrying import Carrying
from services.gateway.reckoning.hops import Array
from services.gateway.reckoning.resampling import Resampler
from shared.walking.stride import StrideLine

__all__ = ["Activity", "Motion", "Walk"]

Activity = Literal["still", "walking", "other"]

_NONE: Array = np.empty(0)
_NONE.flags.writeable = False


def _none() -> Array:
    return _NONE


@dataclass(frozen=True, slots=True)
class Motion:
    """What happened between ``t_start`` and ``t``, times on the phone's clock.

    Steps are told once and in order of time; when walking is recognised its first steps lie before the end of the
    report before, and ``t_start`` reaches back to the first of them. Headings are counter-clockwise from the plan's +x.
    """

    t_start: float
    t: float
    activity: Activity
    step_t: Array = field(default_factory=_none)
    """(n,) s."""
    step_t_variance: Array = field(default_factory=_none)
    """(n,) s²."""
    length: Array = field(default_factory=_none)
    """(n,) m."""
    length_variance: Array = field(default_factory=_none)
    """(n,) m², of a step taken by itself."""
    heading: Array = field(default_factory=_none)
    """(n,) rad."""
    heading_variance: Array = field(default_factory=_none)
    """(n,) rad², of a step taken by itself."""
    other_heading: Array = field(default_factory=_none)
    """(n,) rad, the other heading where a sign is uncertain."""
    other_probability: Array = field(default_factory=_none)
    """(n,) of ``other_heading`` being right."""
    magnetic: Array = field(default_factory=_none)
    """(n,) µT, of the magnetic field at each step, NaN without a compass."""
    walk: int = 0
    """Counts up when walking begins anew."""
    heading_bias_variance: float = 0.0
    """rad², of the error all headings of this walk have in common; part of ``heading_variance``."""
    length_scale_variance: float = 0.0
    """Of the factor by which all lengths of this walk are wrong; part of ``length_variance``."""
    turn_t: Array = field(default_factory=_none)
    """(k,) s."""
    turn: Array = field(default_factory=_none)
    """(k,) rad, left is positive."""


class Walk:
    """All that is remembered of one phone: one record of the algorithms' states and the samples of its open hop.

    Args:
        carrying: how the phone is carried.
        line: the person's own stride model, where there is one; may be set at any time.
        walks: how many walks have been told of before.
        thresholds: the person's own step thresholds (δ, ρ), m/s², from trial walks; may be set at any time.
    """

    __slots__ = ("calibration", "carrying", "detector", "line", "record", "resampler", "thresholds", "walks")

    def __init__(
        self,
        carrying: Carrying = "unknown",
        line: StrideLine | None = None,
        walks: int = 0,
        thresholds: tuple[float, float] | None = None,
    ) -> None:
        self.carrying: Carrying = carrying
        self.line = line
        self.walks = walks
        self.thresholds = thresholds
        self.record: NDArray[np.uint8] | None = None
        """The bytes of the record of ``DeadReckoner``; None before the first hop."""
        self.detector = ""
        """Name of the step detector whose record it is."""
        self.calibration: NDArray[np.uint8] | None = None
        """What an idle phone keeps of its record: the bytes of ``Calibration.STATE``, with which records begin."""
        self.resampler = Resampler()

    def rest(self) -> None:
        """Give the memory of an idle phone back; what gyroscope and compass are off by stays known."""
        if self.record is not None:
            self.calibration = self.record[: Calibration.STATE.itemsize].copy()
        self.record = None
        self.resampler = Resampler()

    @property
    def late(self) -> int:
        """Samples dropped so far because their time had been passed."""
        return self.resampler.late

    @property
    def nbytes(self) -> int:
        """Bytes of memory held."""
        kept = (self.record, self.calibration)
        return self.resampler.nbytes + sum(part.nbytes for part in kept if part is not None)
