"""What all routes work with."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TypeVar

from services.gateway.adapters.numbering import Numbering
from services.gateway.devices.consent import ConsentText
from services.gateway.devices.erasures import Erasures
from services.gateway.devices.own_alerts import OwnAlertBook
from services.gateway.devices.own_position import OwnPositions
from services.gateway.devices.storage import DeviceStore
from services.gateway.phones.phone_book import PhoneBook
from services.gateway.phones.receivers import ReceiverBook
from services.gateway.settings import GatewaySettings
from services.gateway.web.bodies import OpenBodies
from shared.bus import Bus
from shared.keys import Keys

__all__ = ["Gateway"]

T = TypeVar("T")


@dataclass(slots=True)
class Gateway:
    """The parts of the gateway behind its HTTP."""

    settings: GatewaySettings
    site: str
    consent: ConsentText
    store: DeviceStore
    phones: PhoneBook
    receivers: ReceiverBook
    erasures: Erasures
    positions: OwnPositions
    alerts: OwnAlertBook
    bodies: OpenBodies
    """All bodies of phones come through it."""
    bus: Bus
    """Staff's orders come by it, and the past is asked for."""
    keys: Keys
    started: Callable[[], None]
    """Called once requests are served."""
    numbering: Numbering = field(default_factory=Numbering)
    """Of the payloads of other programs; touched by the event loop only."""
    _workers: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(2, "gateway"))

    async def work(self, task: Callable[..., T], *arguments: object) -> T:
        """Run what may take long, the database above all, in a thread: nothing holds the event loop."""
        return await asyncio.get_running_loop().run_in_executor(self._workers, task, *arguments)

    def close(self) -> None:
        """Let the threads go, once what they have begun is done."""
        self._workers.shutdown(cancel_futures=True)
