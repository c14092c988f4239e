"""How does what phones said reach the bus, in order and acknowledged only when it cannot be lost any more?"""

from __future__ import annotations

import time
from collections.abc import Sequence

import msgspec
import structlog
from sqlalchemy.exc import SQLAlchemyError

from services.gateway.phones.phone import Phone
from services.gateway.phones.spool import Spool, SpoolFullError
from shared.bus import Bus, Publisher
from shared.keys import Keys
from shared.messages import MotionBatch, RadioScan

__all__ = ["Dispatcher"]

DRAINED_AT_ONCE = 500
"""Messages; what phones send meanwhile does not wait for all of a long absence."""

log = structlog.get_logger(__name__)


class Dispatcher:
    """Publishes outboxes; where the bus is away, or a phone's older messages wait already, they go to the spool.

    Zenoh gives no receipt, so the connection is looked at before and after a group is published: what was published
    last before it was missed may arrive twice, under the same ``seq``. What is put into a link that is dead and not yet
    known to be is lost; a router that ends closes its links, one that is cut off is missed after Zenoh's lease.

    Args:
        bus: where to publish.
        keys: of the site.
        spool: None: what cannot be published stays in the outbox.
        lateness: seconds after which what waited is marked late.
    """

    def __init__(self, bus: Bus, keys: Keys, spool: Spool | None, lateness: float) -> None:
        self._bus = bus
        self._keys = keys
        self._spool = spool
        self._lateness = lateness
        self._radio: dict[str, Publisher[RadioScan]] = {}
        self._motion: dict[str, Publisher[MotionBatch]] = {}

    def send(self, phones: Sequence[Phone]) -> None:
        """Empty the outboxes of some phones: what is still in them after it is neither published nor stored."""
        if self._bus.connected:
            self._publish_outboxes(
                [phone for phone in phones if self._spool is None or phone.device not in self._spool]
            )
        left = [phone for phone in phones if phone.outbox]
        if left and self._spool is not None:
            try:
                self._spool.put([message for phone in left for message in phone.outbox])
            except (SpoolFullError, SQLAlchemyError) as error:
                log.warning("not spooled", error=str(error).partition("\n")[0] or type(error).__name__)
                return
            for phone in left:
                phone.outbox.clear()

    def drain(self) -> None:
        """Publish the oldest of what waits in the spool, if the bus is there."""
        if not self._spool or not self._bus.connected:
            return
        waiting = self._spool.oldest(DRAINED_AT_ONCE)
        now = time.time()
        for message in (entry.message for entry in waiting if entry.message is not None):
            late = message.late or now - message.t > self._lateness
            self._publish(msgspec.structs.replace(message, late=late))
        if self._bus.connected:
            self._spool.drop(waiting)

    def hush(self, device: str) -> None:
        """Withdraw the publishers of a device."""
        for publisher in (self._radio.pop(device, None), self._motion.pop(device, None)):
            if publisher is not None:
                publisher.close()

    def forget(self, device: str) -> None:
        """Withdraw the publishers of a device and erase what waits of it."""
        self.hush(device)
        if self._spool is not None:
            self._spool.forget(device)

    def _publish_outboxes(self, phones: Sequence[Phone]) -> None:
        sent: list[tuple[Phone, RadioScan | MotionBatch]] = []
        for phone in phones:
            try:
                while phone.outbox:
                    self._publish(phone.outbox[0])
                    sent.append((phone, phone.outbox.popleft()))
            except Exception as error:  # Zenoh's; the other phones' may still go
                log.warning("publishing failed", device=phone.device, error=str(error))
        if sent and not self._bus.connected:
            for phone, message in reversed(sent):
                phone.outbox.appendleft(message)

    def _publish(self, message: RadioScan | MotionBatch) -> None:
        device = message.device
        if isinstance(message, RadioScan):
            radio = self._radio.get(device)
            if radio is None:
                radio = self._radio[device] = self._bus.publisher(self._keys.radio(device), RadioScan)
            radio.publish(message)
        else:
            motion = self._motion.get(device)
            if motion is None:
                motion = self._motion[device] = self._bus.publisher(self._keys.motion(device), MotionBatch)
            motion.publish(message)
