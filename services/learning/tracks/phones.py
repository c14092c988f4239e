"""What phones said in the last minute or so: what an area's access points they hear, and how they walk.

Every area hears all phones of the site, whether its own fusion works or not. So each phone's rows are bounded by its
own newest time, and who has been silent for as long is forgotten; a time far ahead of everybody's is left out, so that
one wrong clock makes nobody look silent.
"""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections.abc import Sequence
from dataclasses import dataclass, field

from services.learning.tracks.stretch import SAME
from shared.messages import MotionBatch, RadioScan

__all__ = ["PhoneRows", "Phones", "Reading", "Step"]

AHEAD = 120.0
"""Seconds by which a time may be ahead of the newest one known."""
TIDIED_EVERY = 10.0
"""Seconds between two looks at what is too old."""

Reading = tuple[float, int, float]
"""t, access point, dBm."""
Step = tuple[float, float, float, float, float, int, float]
"""t, length, its variance, heading, its variance, walk, magnetic field (NaN: not told)."""


@dataclass
class PhoneRows:
    """One phone's, each in order of time; ``still``: begin and end; ``newest``: when it last told anything."""

    readings: list[Reading] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)
    still: list[tuple[float, float]] = field(default_factory=list)
    newest: float = -math.inf

    def forget_before(self, t: float) -> None:
        """Forget what is older than ``t``."""
        for rows in (self.readings, self.steps, self.still):
            del rows[: bisect_left(rows, (t,))]


class Phones(dict[str, PhoneRows]):
    """Phones by id.

    Args:
        points: ids of the area's access points; others are left out.
        kept: seconds kept of a phone, and after which a silent one is forgotten.
    """

    def __init__(self, points: Sequence[str], kept: float) -> None:
        super().__init__()
        self._column = {name: number for number, name in enumerate(points)}
        self._kept = kept
        self._newest = -math.inf
        self._tidied = -math.inf

    def take_time(self, t: float) -> None:
        """Take in what time it is in the area, which counts more than what phones say."""
        self._newest = t
        self._tidy()

    def take_scan(self, scan: RadioScan) -> None:
        """Take in what a phone heard."""
        phone = self._heard(scan.device, scan.t)
        if phone is None:
            return
        for name, level in zip(scan.access_point, scan.rssi, strict=True):
            if name in self._column and -120.0 <= level <= 0.0:
                insort(phone.readings, (scan.t, self._column[name], level))

    def take_motion(self, batch: MotionBatch) -> None:
        """Take in how a phone walked; a batch may replace what was told before."""
        phone = self._heard(batch.device, max((batch.t, *batch.step_t)))
        if phone is None:
            return
        if batch.revises_from is not None:
            for rows in (phone.steps, phone.still):
                del rows[bisect_left(rows, (batch.revises_from - SAME,)) :]
        if batch.activity == "still" and not batch.step_t:
            insort(phone.still, (batch.t_start, batch.t))
        columns = (batch.step_t, batch.length, batch.length_variance, batch.heading, batch.heading_variance)
        strengths = batch.magnetic or [math.nan] * len(batch.step_t)
        for *row, strength in zip(*columns, strengths, strict=True):
            insort(phone.steps, (*row, batch.walk, strength))

    def clear(self) -> None:
        """Forget all phones, and what time it is."""
        super().clear()
        self._newest = self._tidied = -math.inf

    def _heard(self, device: str, t: float) -> PhoneRows | None:
        """Return a phone that told something of time ``t``; None if that is too far ahead."""
        if self._newest > -math.inf and t > self._newest + AHEAD:
            return None
        self._newest = max(self._newest, t)
        phone = self.setdefault(device, PhoneRows())
        phone.newest = max(phone.newest, t)
        self._tidy()
        return phone

    def _tidy(self) -> None:
        if abs(self._newest - self._tidied) < TIDIED_EVERY:
            return
        self._tidied = self._newest
        for device, phone in list(self.items()):
            # Ahead: from before the area told its first time.
            if self._newest - self._kept <= phone.newest <= self._newest + AHEAD:
                phone.forget_before(phone.newest - self._kept)
            else:
                del self[device]
