"""Which ``seq`` does a foreign payload get? Apps count anew with every recording, or not at all."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable

__all__ = ["Numbering"]

REMEMBERED = 128
"""Payloads of a device that are known again when they are sent twice."""


class Numbering:
    """Gives the payloads of each device increasing numbers, the same one to the same payload; one thread only.

    A device's numbers begin at the time in hundredths of a second: after a restart of the gateway they are still higher
    than all before.

    Args:
        devices: how many are remembered; the one longest silent is forgotten first.
        clock: s since 1970.
    """

    def __init__(self, devices: int = 10_000, clock: Callable[[], float] = time.time) -> None:
        self._devices = devices
        self._clock = clock
        self._given: OrderedDict[str, OrderedDict[int, int]] = OrderedDict()

    def number(self, device: str, key: tuple[str, ...]) -> int:
        """Return the number of the payload that ``key`` stands for."""
        given = self._given.setdefault(device, OrderedDict())
        self._given.move_to_end(device)
        if len(self._given) > self._devices:
            self._given.popitem(last=False)
        name = hash(key)
        found = given.get(name)
        if found is None:
            found = given[name] = next(reversed(given.values())) + 1 if given else int(self._clock() * 100.0)
            if len(given) > REMEMBERED:
                given.popitem(last=False)
        return found

    def forget(self, device: str) -> None:
        """Forget a device."""
        self._given.pop(device, None)
