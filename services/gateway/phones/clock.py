"""What must be added to a phone's clock to get the server's? Offset and drift, from the stamps of its requests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["ClockAligner"]

Array = NDArray[np.float64]

WINDOW = 7200.0
"""Seconds of bounds that one line explains; longer ago, a quartz was at another temperature."""
MOST = 64
"""Bounds of a side remembered at once."""
DRIFTS = np.linspace(-2e-4, 2e-4, 161)
"""Drifts looked at; quartz stays within 100 ppm."""
USUAL_DRIFT = 5e-5
"""Standard deviation of phones' drifts."""
USUAL_JOURNEY = 0.2
"""s; the scale of what a journey takes beyond the quickest."""
JUMP = 5.0
"""Seconds of apparent delay that, three times running, mean that the phone's clock was set back."""
JUMP_AFTER = 3
SLOW = 0.5
"""The same where it takes longer to be sure: so much delay, about the same each time."""
SLOW_AFTER = 30
FORWARD = 0.5
"""Seconds by which a journey undercuts all before that make those useless: it was quick, or the clock was set on."""
SLOWEST = 60.0
"""Seconds there and back that a journey may take to be believed."""
CONTRADICTION = 0.1
"""Seconds by which bounds may exclude each other before the clock must have been set."""
COUNTED = 3600
"""Bounds that weigh; older ones fade."""
SURE_AFTER = 32
"""Bounds after which the line is fitted anew only where one does not fit it, or after ``REFIT`` seconds."""
REFIT = 10.0


class _Bounds:
    """The tightest of the bounds of one side: a convex hull, seen from below where the bounds are upper ones.

    Only a corner of the hull can touch a line that all bounds lie on one side of, so nothing else need be remembered.

    Args:
        side: 1 for upper bounds, -1 for lower ones, whose signs are turned.
    """

    __slots__ = ("corners", "count", "mean", "side")

    def __init__(self, side: float) -> None:
        self.side = side
        self.corners: list[tuple[float, float]] = []
        self.count = 0
        self.mean = 0.0
        """Of the times of all bounds."""

    def add(self, t: float, bound: float) -> None:
        """Take one bound; one that was overtaken by a newer request is left out."""
        corners = self.corners
        if corners and t <= corners[-1][0]:
            if t < corners[-1][0] or self.side * bound >= corners[-1][1]:
                return
            corners.pop()
        point = (t, self.side * bound)
        while len(corners) >= 2 and _turns_down(corners[-2], corners[-1], point):
            corners.pop()
        corners.append(point)
        while corners[0][0] < t - WINDOW or len(corners) > MOST:
            corners.pop(0)
        self.count = min(self.count + 1, COUNTED)
        self.mean += (t - self.mean) / self.count

    def touching(self, since: float) -> Array:
        """Return, for each of ``DRIFTS``, the value at ``since`` of the line that touches the bounds."""
        corners = np.array(self.corners)
        touching: Array = (corners[:, 1:] - self.side * (corners[:, :1] - since) * DRIFTS).min(axis=0)
        return self.side * touching


class ClockAligner:
    """Estimates one phone's clock offset and drift from the stamps of its requests.

    A request sent at phone time s and received at server time r bounds the offset from above, since travel takes
    time: offset(s) <= r - s. A reply sent at server time r and arrived at phone time a bounds it from below:
    offset(a) >= r - a. The offset is a straight line in time: under the convex hull of the upper bounds and above
    that of the lower ones (the linear program of Moon, Skelly and Towsley, INFOCOM 1999). Of all drifts the one is
    taken that makes all journeys together the shortest, unless it is unusual; of all lines of this drift the one
    half-way between the hulls, or, where no reply is echoed, the one that touches the upper hull, which errs by the
    quickest journey.
    """

    __slots__ = ("_drift", "_fitted", "_late", "_lower", "_newest", "_offset", "_slow", "_slow_since", "_upper")

    def __init__(self) -> None:
        self._upper, self._lower = _Bounds(1.0), _Bounds(-1.0)
        self._newest = 0.0
        self._fitted = 0.0
        self._offset = 0.0
        """At ``_fitted``, a time of the phone's clock; it grows by ``_drift`` a second."""
        self._drift = 0.0
        self._late = self._slow = 0
        self._slow_since = 0.0

    @property
    def offset(self) -> float:
        """Server clock minus phone clock when the last request was sent, seconds (0 before the first)."""
        return self.offset_at(self._newest)

    @property
    def drift(self) -> float:
        """Seconds by which the offset grows in a second."""
        return self._drift

    def offset_at(self, t: float) -> float:
        """Return server clock minus phone clock at time ``t`` of the phone's clock, seconds."""
        return self._offset + self._drift * (t - self._fitted)

    def observe(self, sent: float, received: float, echo: tuple[float, float] | None = None) -> float:
        """Take the stamps of one request and return the offset.

        Args:
            sent: phone clock when the request was sent.
            received: server clock when it arrived; must not run backwards.
            echo: (``replied``, ``arrived``) of the previous reply: server clock, phone clock.
        """
        upper = received - sent
        # A reply that arrived before it was sent is not believed, nor one that was under way for so long.
        lower = echo if echo is not None and 0.0 <= upper - (echo[0] - echo[1]) <= SLOWEST else None
        if self._upper.count and (self._set_back(sent, upper) or self._contradicted(sent, upper, lower)):
            self._upper, self._lower = _Bounds(1.0), _Bounds(-1.0)
            self._late = self._slow = 0
            self._newest = sent
        fits = self._upper.count > SURE_AFTER and upper >= self.offset_at(sent) and sent < self._fitted + REFIT
        self._upper.add(sent, upper)
        if lower is not None:
            replied, arrived = lower
            fits = fits and replied - arrived <= self.offset_at(arrived) and self._lower.count > SURE_AFTER
            self._lower.add(arrived, replied - arrived)
        self._newest = max(sent, self._newest)
        if not fits:
            self._fit()
        return self.offset

    def _set_back(self, sent: float, upper: float) -> bool:
        """Whether requests seem so late, again and again, that the clock was rather set back.

        A request that was kept and sent later under its old stamp is late too, but it does not go back in time, and the
        delay of the next one kept is another.
        """
        delay = upper - self.offset_at(sent)
        self._late = self._late + 1 if delay > JUMP and sent < self._newest else 0
        if delay <= SLOW or abs(upper - self._slow_since) > 2.0 * SLOW:
            self._slow, self._slow_since = 0, upper
        self._slow += 1 if delay > SLOW else 0
        return self._late >= JUMP_AFTER or self._slow >= SLOW_AFTER

    def _contradicted(self, sent: float, upper: float, lower: tuple[float, float] | None) -> bool:
        """Whether the clock must have been set, since no journey takes less than no time."""
        below = self.offset_at(sent) - upper
        if below > FORWARD:
            return True
        slack, most = CONTRADICTION, float(DRIFTS[-1])
        if below > 0.0 and any(upper < -corner - most * abs(sent - t) - slack for t, corner in self._lower.corners):
            return True
        if lower is None:
            return False
        bound, arrived = lower[0] - lower[1], lower[1]
        return bound > self.offset_at(arrived) and any(
            bound > corner + most * abs(arrived - t) + slack for t, corner in self._upper.corners
        )

    def _fit(self) -> None:
        self._fitted = since = self._newest
        upper = self._upper.touching(since)
        weight = self._upper.count / USUAL_JOURNEY
        skill = weight * (upper + DRIFTS * (self._upper.mean - since))
        middle = upper
        if self._lower.count:
            lower = self._lower.touching(since)
            weight = self._lower.count / USUAL_JOURNEY
            skill = skill - weight * (lower + DRIFTS * (self._lower.mean - since))
            middle = (upper + lower) / 2.0
        best = int(np.argmax(skill - 0.5 * (DRIFTS / USUAL_DRIFT) ** 2))
        self._offset, self._drift = float(middle[best]), float(DRIFTS[best])


def _turns_down(first: tuple[float, float], middle: tuple[float, float], last: tuple[float, float]) -> bool:
    """Whether ``middle`` lies on or above the line from ``first`` to ``last``."""
    across = (middle[0] - first[0]) * (last[1] - first[1])
    return across <= (last[0] - first[0]) * (middle[1] - first[1])
