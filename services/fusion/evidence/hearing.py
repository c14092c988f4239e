"""What each device's ears are like: how much it reads too much, and the scans gathered into one."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Gathered", "Hearing"]

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Gathered:
    """Scans of about a second as one.

    Attributes:
        t: mean time.
        heard: (h,), columns of the access points.
        level: (h,), mean strengths, dBm; ``count``: (h,) of how many readings.
        elapsed: seconds since the ones before; infinity for none.
        walked: metres the device walked meanwhile, as far as it told.
    """

    t: float
    heard: NDArray[np.int64]
    level: Array
    count: Array
    elapsed: float
    walked: float


@dataclass
class Hearing:
    """One device's scans of one kind: what it heard, or what receivers heard of it.

    Attributes:
        offset, variance: of what it reads too much, dB and dB².
        newest: time of the newest scan taken; ``fired``: of the last one handed on.
        walked: metres since then; ``stood``: seconds for which it has stood.
    """

    offset: float
    variance: float
    newest: float = -math.inf
    fired: float = -math.inf
    walked: float = 0.0
    stood: float = 0.0
    total: dict[int, list[float]] = field(default_factory=dict)
    times: list[float] = field(default_factory=list)

    def take(self, t: float, readings: dict[int, float], gather: float) -> Gathered | None:
        """Take in a scan; return what was gathered when ``gather`` seconds are over."""
        self.newest = t
        self.times.append(t)
        for column, level in readings.items():
            entry = self.total.setdefault(column, [0.0, 0.0])
            entry[0] += level
            entry[1] += 1.0
        if t - self.fired < gather:
            return None
        heard = np.array(sorted(self.total))
        sums = np.array([self.total[column] for column in heard.tolist()])
        gathered = Gathered(
            t=sum(self.times) / len(self.times),
            heard=heard,
            level=sums[:, 0] / sums[:, 1],
            count=sums[:, 1],
            elapsed=t - self.fired,
            walked=self.walked,
        )
        self.fired, self.walked = t, 0.0
        self.total, self.times = {}, []
        return gathered

    def state(self) -> dict[str, Any]:
        """Return a copy; times that never were are None."""
        return {
            "numbers": [self.offset, self.variance, self.walked, self.stood],
            "newest": self.newest if math.isfinite(self.newest) else None,
            "fired": self.fired if math.isfinite(self.fired) else None,
            "total": {str(column): list(entry) for column, entry in self.total.items()},
            "times": list(self.times),
        }

    @classmethod
    def restored(cls, state: dict[str, Any]) -> Hearing:
        """Return what ``state()`` was taken of."""
        offset, variance, walked, stood = (float(number) for number in state["numbers"])
        newest, fired = (-math.inf if state[name] is None else float(state[name]) for name in ("newest", "fired"))
        total = {int(column): [float(one) for one in entry] for column, entry in state["total"].items()}
        return cls(offset, variance, newest, fired, walked, stood, total, [float(t) for t in state["times"]])
