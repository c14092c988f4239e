"""Which samples at even times do a phone's uneven ones stand for? Streaming, whatever its sample clock does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.gateway.reckoning.hops import HOP, RATE, Array, Hops

__all__ = ["CLOCK_BACK", "LONGEST_GAP", "WAIT", "InertialSamples", "Resampler", "SingleHop", "stack"]

LONGEST_GAP = 0.3
"""Seconds bridged by a straight line; phones leave holes to 0.1 s (Android), polling loggers to 0.3 s."""
WAIT = 0.3
"""Seconds for which samples may still come out of order, from batch to batch too."""
CLOCK_BACK = 5.0
"""A sample this many seconds before one that came earlier means that the phone's clock was set back."""

FEWEST = 5
"""Samples without a hole between them that are worth a hop: 0.1 s of them; fewer are dropped."""

_GAP = int(LONGEST_GAP * RATE)
_FIELD = slice(6, 9)
_MOST = 1000  # samples kept without looking at them


@dataclass(frozen=True, slots=True)
class InertialSamples:
    """Samples in the phone's axes (x right, y to the top, z out of the screen)."""

    t: Array
    """(n,) seconds, phone clock."""
    acceleration: Array
    """(n, 3) m/s², gravity included."""
    rotation: Array | None
    """(n, 3) rad/s, or None where there is no gyroscope."""
    field: Array | None
    """(n, 3) µT, or None where there is no compass; NaN where it has no sample at this time."""


@dataclass(frozen=True, slots=True)
class SingleHop:
    """One hop of one phone: what ``Hops`` has of many."""

    t: float
    count: int
    fresh: bool
    values: Array
    """(HOP, 9): acceleration, rotation, field."""


def stack(hops: Sequence[SingleHop]) -> Hops:
    """Return one hop of each of p phones as arrays."""
    values = np.stack([hop.values for hop in hops])
    return Hops(
        t=np.array([hop.t for hop in hops]),
        count=np.array([hop.count for hop in hops]),
        fresh=np.array([hop.fresh for hop in hops]),
        acceleration=values[:, :, 0:3],
        rotation=values[:, :, 3:6],
        field=values[:, :, _FIELD],
    )


class Resampler:
    """Averages the samples of one phone in bins of ``1 / RATE`` s, bridges short holes and cuts the rest into hops.

    Samples may come unevenly, doubled and out of order by ``WAIT``, within a batch and from batch to batch; older ones
    are dropped. What comes out depends on the samples in the order in which they came, not on how they were cut into
    batches.
    """

    __slots__ = (
        "_due",
        "_field",
        "_field_bin",
        "_fresh",
        "_index",
        "_kept",
        "_means",
        "_newest",
        "_open",
        "_start",
        "_waiting",
        "late",
    )

    def __init__(self) -> None:
        self.late = 0
        """Samples dropped so far because their time had been passed."""
        self._waiting: list[Array] = []
        self._kept = 0
        self._restart()

    def _restart(self) -> None:
        self._open = np.empty((0, 10))  # of bins that may still get samples
        self._newest = -np.inf
        self._due = -np.inf
        self._index = np.empty(0, np.int64)  # bins of the next hop that have samples, and the last one before it
        self._means = np.empty((0, 9))
        self._field, self._field_bin = np.full(3, np.nan), -(2**62)
        self._start: int | None = None  # bin in which the next hop begins
        self._fresh = True

    @property
    def nbytes(self) -> int:
        """Bytes of memory held."""
        return sum(rows.nbytes for rows in (*self._waiting, self._open, self._index, self._means))

    def push(self, samples: InertialSamples) -> list[SingleHop]:
        """Take samples in the order in which they came; return the hops that are complete.

        Work is done once a hop is due; until then samples are only kept.
        """
        n = len(samples.t)
        if not n:
            return []
        rows = np.zeros((n, 10))
        rows[:, 0] = samples.t
        rows[:, 1:4] = samples.acceleration
        if samples.rotation is not None:
            rows[:, 4:7] = samples.rotation
        rows[:, 7:10] = np.nan if samples.field is None else samples.field
        self._waiting.append(rows)
        self._kept += n
        if self._kept < _MOST and samples.t.max() < self._due and samples.t.min() > self._newest - CLOCK_BACK:
            return []
        return self._work()

    def finish(self) -> list[SingleHop]:
        """Return what is left at the end of a recording."""
        hops = self._work() + self._end()
        self._restart()
        return hops

    def _work(self) -> list[SingleHop]:
        if not self._waiting:
            return []
        rows = self._waiting[0] if len(self._waiting) == 1 else np.concatenate(self._waiting)
        self._waiting, self._kept = [], 0
        hops: list[SingleHop] = []
        if rows[0, 0] > self._newest and (rows[1:, 0] > rows[:-1, 0]).all():  # as most phones send them
            self._newest = float(rows[-1, 0])
            hops += self._take(rows)
            rows = rows[:0]
        while len(rows):
            newest = np.maximum(np.maximum.accumulate(rows[:, 0]), self._newest)
            behind = newest - rows[:, 0]
            set_back = np.flatnonzero(behind > CLOCK_BACK)
            stop = int(set_back[0]) if len(set_back) else len(rows)
            if stop:
                self._newest = float(newest[stop - 1])
                in_time = behind[:stop] <= WAIT
                self.late += stop - int(np.count_nonzero(in_time))
                hops += self._take(rows[:stop][in_time])
            rows = rows[stop:]
            if len(rows):
                hops += self._end()
                self._restart()
        self._due = self._newest if self._start is None else (self._start + HOP) / RATE + WAIT
        return hops

    def _take(self, rows: Array) -> list[SingleHop]:
        rows = np.concatenate([self._open, rows])
        if not (rows[1:, 0] > rows[:-1, 0]).all():
            rows = rows[np.unique(rows[:, 0], return_index=True)[1]]
        bins = np.floor(rows[:, 0] * RATE).astype(np.int64)
        until = int(np.floor((self._newest - WAIT) * RATE))  # no sample comes any more before this bin
        closed = int(np.searchsorted(bins, until))
        self._open = rows[closed:]
        self._close(bins[:closed], rows[:closed, 1:])
        return self._cut(until)

    def _end(self) -> list[SingleHop]:
        """Close every bin: nothing follows."""
        bins = np.floor(self._open[:, 0] * RATE).astype(np.int64)
        self._close(bins, self._open[:, 1:])
        return self._cut(int(self._index[-1]) + _GAP + 2) if len(self._index) else []

    def _close(self, bins: NDArray[np.int64], values: Array) -> None:
        """Append the means of bins that will get no more samples."""
        if not len(bins):
            return
        starts = np.concatenate([[0], np.flatnonzero(bins[1:] != bins[:-1]) + 1])
        index = bins[starts]
        counts = np.append(starts[1:], len(bins))[:, None] - starts[:, None]
        blind = np.isnan(values[:, 6])
        if blind.any():
            known = np.add.reduceat(np.where(blind, 0.0, 1.0), starts)[:, None]
            means = np.add.reduceat(np.where(np.isnan(values), 0.0, values), starts, axis=0)
            means[:, :6] /= counts
            means[:, _FIELD] = np.where(known > 0.0, means[:, _FIELD] / np.maximum(known, 1.0), np.nan)
        else:
            means = np.add.reduceat(values, starts, axis=0) / counts
        self._hold_field(index, means)
        self._index = np.concatenate([self._index, index])
        self._means = np.concatenate([self._means, means])

    def _hold_field(self, index: NDArray[np.int64], means: Array) -> None:
        """Let a compass that samples seldom keep its value for as long as a gap may last."""
        seen = np.flatnonzero(~np.isnan(means[:, 6]))
        if len(seen) < len(index):
            last = np.searchsorted(seen, np.arange(len(index)), side="right") - 1
            bins = np.append(index[seen], self._field_bin)  # -1 stands for the one before
            values = np.concatenate([means[seen, _FIELD], self._field[None]])
            held = (index - bins[last] <= _GAP)[:, None]
            means[:, _FIELD] = np.where(held, values[last], np.nan)
        if len(seen):
            self._field_bin, self._field = int(index[seen[-1]]), means[seen[-1], _FIELD].copy()

    def _cut(self, until: int) -> list[SingleHop]:
        """Return the hops before bin ``until`` that are complete or end in a hole, and forget what they used."""
        hops: list[SingleHop] = []
        if not len(self._index):
            return hops
        ends = until > int(self._index[-1]) + _GAP
        self._drop_islands(ends)
        index, means = self._index, self._means
        holes = np.append(np.flatnonzero(index[1:] - index[:-1] > _GAP), len(index) - 1)
        low = 0
        while low < len(index):
            if self._start is None:
                self._start, self._fresh = int(index[low]), True
            hole = int(holes[np.searchsorted(holes, low)])  # the last row before the next hole
            stop = self._start + HOP
            if self._fresh and hole - low + 1 < FEWEST:
                break  # more may follow
            if index[hole] >= stop - 1:
                hops.append(self._hop(self._start, index[low : hole + 1], means[low : hole + 1], HOP))
                low = int(np.searchsorted(index, stop - 1, side="right")) - 1
                self._start, self._fresh = stop, False
            elif hole < len(index) - 1 or ends:
                count = int(index[hole]) - self._start + 1
                if count > 0:
                    hops.append(self._hop(self._start, index[low : hole + 1], means[low : hole + 1], count))
                self._start, low = None, hole + 1
            else:
                break
        self._index, self._means = index[low:], means[low:]
        return hops

    def _drop_islands(self, ends: bool) -> None:
        """Forget samples between two holes that are too few for a hop; the last ones only if a hole follows them."""
        index = self._index
        holes = np.append(np.flatnonzero(index[1:] - index[:-1] > _GAP), len(index) - 1)
        sizes = np.diff(holes, prepend=-1)
        few = sizes < FEWEST
        few[0] &= self._start is None or self._fresh
        few[-1] &= ends
        if few[0]:
            self._start = None
        if few.any():
            kept = np.repeat(~few, sizes)
            self._index, self._means = index[kept], self._means[kept]

    def _hop(self, start: int, index: NDArray[np.int64], means: Array, count: int) -> SingleHop:
        even = np.minimum(np.arange(start, start + HOP), start + count - 1)
        after = np.searchsorted(index, even)  # the first row that is not before
        before = np.maximum(after - (index[after] != even), 0)
        width = np.maximum(index[after] - index[before], 1)
        share = ((even - index[before]) / width)[:, None]
        values = means[before] if not share.any() else (1.0 - share) * means[before] + share * means[after]
        return SingleHop((start + 0.5) / RATE, count, self._fresh, values)
