"""What must be added to a phone's clock to get the server's? A minimum-delay filter per phone."""

from __future__ import annotations

from collections import deque

__all__ = ["ClockAligner"]


class ClockAligner:
    """Estimates one phone's clock offset from the stamps of its requests.

    A request sent at phone time s and received at server time r bounds the offset from above, since travel takes
    time: offset <= r - s. A reply sent at server time r and arrived at phone time a bounds it from below: offset >=
    r - a. The tightest bounds of the last two minutes (quartz drifts by 100 ppm at most: 12 ms) enclose the offset;
    without echoed replies the upper bound stands alone and errs by the quickest journey. The idea is NTP's clock
    filter (RFC 5905, section 10).
    """

    WINDOW = 120.0
    JUMP = 5.0
    """Seconds of apparent delay that, three times running, mean that the phone's clock was set back."""
    JUMP_AFTER = 3

    def __init__(self) -> None:
        self._upper: deque[tuple[float, float]] = deque()
        self._lower: deque[tuple[float, float]] = deque()
        self._late = 0

    @property
    def offset(self) -> float:
        """Server clock minus phone clock, seconds (0 before the first observation)."""
        if not self._upper:
            return 0.0
        upper = min(bound for _, bound in self._upper)
        if not self._lower:
            return upper
        return (upper + max(bound for _, bound in self._lower)) / 2.0

    def observe(self, sent: float, received: float, echo: tuple[float, float] | None = None) -> float:
        """Take the stamps of one request and return the offset.

        Args:
            sent: phone clock when the request was sent.
            received: server clock when it arrived; must not run backwards.
            echo: (``replied``, ``arrived``) of the previous reply: server clock, phone clock.
        """
        upper = received - sent
        lower = None if echo is None else echo[0] - echo[1]
        if lower is not None and lower > upper:
            lower = None  # it would have arrived before it was sent: not believed
        if self._upper:
            best = min(bound for _, bound in self._upper)
            self._late = self._late + 1 if upper > best + self.JUMP else 0
            below = max((bound for _, bound in self._lower), default=upper)
            if self._late >= self.JUMP_AFTER or upper < below or (lower is not None and lower > best):
                self._upper.clear()
                self._lower.clear()
                self._late = 0
        self._upper.append((received, upper))
        if lower is not None:
            self._lower.append((received, lower))
        for bounds in (self._upper, self._lower):
            while bounds and bounds[0][0] < received - self.WINDOW:
                bounds.popleft()
        return self.offset
