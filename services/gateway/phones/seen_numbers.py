"""Which batches of one source were seen? Their numbers as ranges, so that a backlog may come after what is live."""

from __future__ import annotations

from bisect import bisect_right

from services.gateway.errors import refuse

__all__ = ["SeenNumbers"]

MOST = 256
"""Ranges remembered: so many gaps may be open at once."""


class SeenNumbers:
    """The numbers seen, as ranges that merge where they meet.

    Where more gaps are open than can be remembered, the oldest is given up: of what lies in it nobody can tell any more
    whether it was seen, and it is refused rather than acknowledged unused.
    """

    __slots__ = ("_first", "_floor", "_last")

    def __init__(self) -> None:
        self._first: list[int] = []
        self._last: list[int] = []
        self._floor = 0
        """Numbers below it that lie in no range cannot be told."""

    def __contains__(self, number: int) -> bool:
        """Whether a number was seen.

        Raises:
            RequestError: 422, it is too old to tell.
        """
        at = bisect_right(self._first, number) - 1
        if at >= 0 and number <= self._last[at]:
            return True
        if number < self._floor:
            refuse("seq", "too old to tell whether it was seen", number, f"{self._floor} or more")
        return False

    def add(self, number: int) -> None:
        """Note a number that was not seen."""
        first, last = self._first, self._last
        at = bisect_right(first, number)
        after_one = at > 0 and last[at - 1] == number - 1
        before_one = at < len(first) and first[at] == number + 1
        if after_one and before_one:
            last[at - 1] = last.pop(at)
            first.pop(at)
        elif after_one:
            last[at - 1] = number
        elif before_one:
            first[at] = number
        else:
            first.insert(at, number)
            last.insert(at, number)
        if len(first) > MOST:
            self._floor = first[1]
            first.pop(0)
            last.pop(0)
