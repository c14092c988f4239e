"""Telling that a store has nothing more of a device whose consent was withdrawn; kept for whoever asks later."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable

from shared.bus import Bus, Publisher
from shared.keys import Keys, is_identifier
from shared.messages import ErasureDone

__all__ = ["Acknowledgements"]

KEPT = 2000
"""Devices whoever joins is told of, as many as the gateway tells erasures of."""


class Acknowledgements:
    """What one service has erased; from any thread.

    Args:
        bus: where it is told.
        keys: of the site.
        service: whose store it is.
    """

    def __init__(self, bus: Bus, keys: Keys, service: str) -> None:
        self._bus = bus
        self._keys = keys
        self._service = service
        self._lock = threading.Lock()
        self._told: OrderedDict[str, Publisher[ErasureDone]] = OrderedDict()
        self._awaited: dict[str, Callable[[], bool]] = {}

    def __contains__(self, device: str) -> bool:
        """Whether it was told of this device."""
        with self._lock:
            return device in self._told

    def await_gone(self, device: str, gone: Callable[[], bool]) -> None:
        """Let ``tell_gone`` tell of a device once ``gone`` says that nothing of it is stored; not twice."""
        with self._lock:
            if device not in self._told:
                self._awaited[device] = gone

    def tell_gone(self) -> None:
        """Tell of those awaited of whom nothing is stored any more."""
        with self._lock:
            awaited = list(self._awaited.items())
        for device, gone in awaited:
            if gone():
                self.tell(device)
                with self._lock:
                    self._awaited.pop(device, None)

    def tell(self, device: str) -> None:
        """Tell that nothing of a device is stored any more; once, however often it is asked."""
        with self._lock:
            if device in self._told or not is_identifier(device):
                return
            publisher = self._bus.publisher(self._keys.erased(device, self._service), ErasureDone, cached=True)
            publisher.publish(ErasureDone(t=time.time(), device=device, service=self._service))
            self._told[device] = publisher
            if len(self._told) > KEPT:
                self._told.popitem(last=False)[1].close()
