"""How do measurements become batches, and when do these reach the gateway? At once, or late and all together."""

from __future__ import annotations

import bisect
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.simulator.phones.fleet import FleetParameters, Flushes
from services.simulator.phones.phone_batch import Inertial, PhoneBatch, PhoneClock, PhoneScan

__all__ = ["Mail"]

Array = NDArray[np.float64]

_BETWEEN_FLUSHED = 0.05  # seconds from one batch of a flush to the next


@dataclass(slots=True)
class _Times:
    """When the next flush is, how much of it is sent, and when the last batch arrived."""

    flush: float = math.inf
    flushed: int = 0
    arrived: float = -math.inf


class Mail:
    """What one phone has measured and not yet put into a batch.

    Attributes:
        samples: pieces of times (n,) and values (n, 9), in order.
        steps: pieces of true ends of steps (k,) and their lengths (k,), in order.
        scans: in order of time.
    """

    def __init__(self, person: str, fleet: FleetParameters, clock: PhoneClock, rng: np.random.Generator) -> None:
        self.samples: list[tuple[Array, Array]] = []
        self.steps: list[tuple[Array, Array]] = []
        self.scans: list[PhoneScan] = []
        self._person = person
        self._fleet = fleet
        self._clock = clock
        self._rng = rng
        self._seq = 0
        self._told = 0
        self._times: _Times | None = None

    def post(self, end: float) -> Iterator[PhoneBatch]:
        """Yield a batch for every stretch of ``batch_seconds`` that is over at ``end`` and has something in it."""
        seconds = self._fleet.batch_seconds
        last = math.floor(end / seconds + 1e-9)
        if not (self.samples or self.scans):
            return
        t, values = _joined(self.samples, 9)
        step_t, step_length = _joined(self.steps, 0)
        scan_t = [scan.t for scan in self.scans]
        begin = min([*t[:1].tolist(), *scan_t[:1]])
        bounds = np.arange(max(math.floor(begin / seconds + 1e-9), self._told) + 1, last + 1) * seconds
        self._told = max(self._told, last)
        samples, steps = np.searchsorted(t, bounds), np.searchsorted(step_t, bounds)
        heard = [bisect.bisect_left(scan_t, bound) for bound in bounds.tolist()]
        i = j = k = 0
        for bound, i_next, j_next, k_next in zip(bounds.tolist(), samples.tolist(), steps.tolist(), heard, strict=True):
            if i_next - i >= 2 or k_next > k:
                inertial = Inertial(t[i:i_next], values[i:i_next]) if i_next - i >= 2 else None
                sent, arrival = self._journey(bound)
                yield PhoneBatch(
                    person=self._person,
                    seq=self._seq,
                    measured_until=bound,
                    sent=sent,
                    arrival=arrival,
                    clock=self._clock,
                    inertial=inertial,
                    scans=tuple(self.scans[k:k_next]),
                    step_t=step_t[j:j_next],
                    step_length=step_length[j:j_next],
                )
                self._seq += 1
            i, j, k = i_next, j_next, k_next
        self.samples = [(t[i:], values[i:])] if i < len(t) else []
        self.steps = [(step_t[j:], step_length[j:])] if j < len(step_t) else []
        self.scans = self.scans[k:]

    def _journey(self, measured: float) -> tuple[float, float]:
        """Return when a batch that is complete at ``measured`` is sent and when it arrives; never before another."""
        rng = self._rng
        if self._times is None:
            self._times = _Times()
            if isinstance(self._fleet.upload, Flushes):
                self._times.flush = measured + self._between_flushes(0.05)
        times = self._times
        low, high = (max(bound, 1e-3) for bound in self._fleet.network_delay)
        delay = math.exp(rng.uniform(math.log(low), math.log(high)))
        if isinstance(self._fleet.upload, Flushes):
            while times.flush < measured:
                times.flush += self._between_flushes(0.9)
                times.flushed = 0
            sent = times.flush + _BETWEEN_FLUSHED * times.flushed
            times.flushed += 1
        else:
            sent = measured + float(rng.uniform(0.005, 0.03))
        # One request after the other.
        sent = max(sent, times.arrived)
        times.arrived = max(sent + delay, times.arrived + 1e-3)
        return sent, times.arrived

    def _between_flushes(self, least: float) -> float:
        """Return seconds to the next flush: a gateway takes nothing older than an hour."""
        upload = self._fleet.upload
        longest = math.inf if upload == "live" else upload.every - 2.0 * self._fleet.batch_seconds
        return longest * float(self._rng.uniform(least, 0.98))


def _joined(parts: list[tuple[Array, Array]], width: int) -> tuple[Array, Array]:
    if not parts:
        return np.empty(0), np.empty((0, width) if width else 0)
    if len(parts) == 1:
        return parts[0]
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])
