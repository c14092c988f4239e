"""Which samples at even times do these uneven ones stand for? Streaming, whatever the phone's sample clock does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["RATE", "Resampler", "Segment"]

RATE = 50.0
"""Hz; what all of dead reckoning works at."""
LONGEST_GAP = 0.3
"""Seconds bridged by a straight line; phones leave holes to 0.1 s (Android), polling loggers to 0.3 s."""
CLOCK_JUMP = 5.0
"""A batch that ends this many seconds before data already used means that the phone's clock was set back."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Segment:
    """Evenly spaced samples without a hole."""

    t: Array
    """(n,) seconds, ``1 / RATE`` apart."""
    values: Array
    """(n, k)."""
    restarts: bool
    """True where this segment does not continue the one before it: filters must forget."""


class Resampler:
    """Averages samples into bins of ``1 / RATE`` s and bridges short holes; state is one open bin.

    Samples may come with jitter, doubled and out of order inside a push; those older than the open bin are dropped.
    The result does not depend on how a recording is cut into pushes, as long as the cuts are in order of time.
    """

    def __init__(self) -> None:
        self.late = 0
        """Samples dropped because their time had been passed."""
        self._open_t = np.empty(0)
        self._open_values = np.empty((0, 0))
        self._last_bin: int | None = None
        self._last_values = np.empty(0)

    def push(self, t: Array, values: Array) -> list[Segment]:
        """Take samples at times ``t`` (n,), finite, with ``values`` (n, k); return what is complete."""
        if not len(t):
            return []
        if len(self._open_t):
            if t.max() < self._open_t[0] - CLOCK_JUMP or values.shape[1] != self._open_values.shape[1]:
                self._last_bin = None
            else:
                t = np.concatenate([self._open_t, t])
                values = np.concatenate([self._open_values, values])
        t, first = np.unique(t, return_index=True)  # in order of time, doubles gone
        values = values[first]
        bins = np.floor(t * RATE).astype(np.int64)
        if self._last_bin is not None:
            fresh = int(np.searchsorted(bins, self._last_bin, side="right"))
            self.late += fresh
            t, values, bins = t[fresh:], values[fresh:], bins[fresh:]
            if not len(t):
                return []
        closed = int(np.searchsorted(bins, bins[-1]))
        self._open_t, self._open_values = t[closed:], values[closed:]
        return self._close(bins[:closed], values[:closed]) if closed else []

    def _close(self, bins: NDArray[np.int64], values: Array) -> list[Segment]:
        starts = np.flatnonzero(np.diff(bins, prepend=bins[0] - 1))
        counts = np.diff(starts, append=len(bins))
        means = np.add.reduceat(values, starts, axis=0) / counts[:, None]
        index = bins[starts]
        restarts = self._last_bin is None
        if self._last_bin is not None:
            index = np.concatenate([[self._last_bin], index])
            means = np.concatenate([self._last_values[None], means])
        self._last_bin, self._last_values = int(index[-1]), means[-1]
        segments = []
        cuts = np.flatnonzero(np.diff(index) > LONGEST_GAP * RATE) + 1
        for part, (begin, end) in enumerate(zip([0, *cuts], [*cuts, len(index)], strict=True)):
            new = restarts or part > 0
            even = np.arange(index[begin] + (0 if new else 1), index[end - 1] + 1)
            if len(even):
                columns = [np.interp(even, index[begin:end], column) for column in means[begin:end].T]
                segments.append(Segment((even + 0.5) / RATE, np.stack(columns, axis=1), new))
        return segments
