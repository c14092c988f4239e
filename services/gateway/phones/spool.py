"""What waits for the bus though it is acknowledged to its phone: in the database, in order, over a restart."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import structlog
from prometheus_client import Counter as Total
from prometheus_client import Gauge
from sqlalchemy import Engine, delete, func, insert, select

from services.gateway.devices.tables import SpoolRow
from shared.messages import MessageError, MotionBatch, RadioScan, decode, encode

__all__ = ["Spool", "SpoolFullError", "Spooled"]

WAITING = Gauge("atrium_gateway_spooled", "Messages that wait in the database for the bus")
UNREADABLE = Total("atrium_gateway_spool_unreadable_total", "Messages set aside since no version of ours reads them")
_KINDS: dict[str, type[RadioScan] | type[MotionBatch]] = {"radio": RadioScan, "motion": MotionBatch}

log = structlog.get_logger(__name__)


class SpoolFullError(RuntimeError):
    """No more fits; nothing was stored."""


@dataclass(frozen=True, slots=True)
class Spooled:
    """One message that waits."""

    id: int
    device: str
    message: RadioScan | MotionBatch | None
    """None where the row cannot be read."""
    size: int
    """Bytes."""


class Spool:
    """The messages that wait, oldest first; used by one thread of one gateway.

    Args:
        engine: an open database with the tables.
        most: bytes of messages that may wait.
    """

    def __init__(self, engine: Engine, most: int) -> None:
        self._engine = engine
        self._most = most
        self._bytes: Counter[str] = Counter()
        self._rows: Counter[str] = Counter()
        self._told = False
        query = select(SpoolRow.device, func.count(), func.sum(func.length(SpoolRow.payload))).group_by(SpoolRow.device)
        with engine.connect() as connection:
            for device, rows, size in connection.execute(query):
                self._rows[device], self._bytes[device] = rows, size
        WAITING.set(len(self))

    def __len__(self) -> int:
        """How many messages wait."""
        return self._rows.total()

    def __contains__(self, device: str) -> bool:
        """Whether anything of a device waits: what is newer must wait behind it."""
        return device in self._rows

    def put(self, messages: Sequence[RadioScan | MotionBatch]) -> None:
        """Store messages behind those that wait; they are safe once this returns.

        Raises:
            SpoolFullError: more would wait than may.
            SQLAlchemyError: the database is away.
        """
        payloads = [encode(message) for message in messages]
        if self._bytes.total() + sum(map(len, payloads)) > self._most:
            raise SpoolFullError
        rows = [
            {
                "device": message.device,
                "kind": "radio" if isinstance(message, RadioScan) else "motion",
                "payload": payload,
            }
            for message, payload in zip(messages, payloads, strict=True)
        ]
        with self._engine.begin() as connection:
            connection.execute(insert(SpoolRow), rows)
        for message, payload in zip(messages, payloads, strict=True):
            self._rows[message.device] += 1
            self._bytes[message.device] += len(payload)
        WAITING.set(len(self))

    def oldest(self, most: int) -> list[Spooled]:
        """Return the messages that wait longest, in order."""
        columns = (SpoolRow.id, SpoolRow.device, SpoolRow.kind, SpoolRow.payload)
        query = select(*columns).order_by(SpoolRow.id).limit(most)
        with self._engine.connect() as connection:
            rows = connection.execute(query).all()
        return [Spooled(row.id, row.device, self._read(row.kind, row.payload), len(row.payload)) for row in rows]

    def _read(self, kind: str, payload: bytes) -> RadioScan | MotionBatch | None:
        try:
            return decode(payload, _KINDS[kind])
        except (KeyError, MessageError) as error:
            if not self._told:
                self._told = True
                log.error("a spooled message cannot be read; such are set aside and counted", reason=str(error)[:200])
            return None

    def drop(self, published: Sequence[Spooled]) -> None:
        """Forget the oldest messages, which are on the bus or cannot be read."""
        with self._engine.begin() as connection:
            connection.execute(delete(SpoolRow).where(SpoolRow.id <= published[-1].id))
        UNREADABLE.inc(sum(entry.message is None for entry in published))
        for entry in published:
            device = entry.device
            self._rows[device] -= 1
            self._bytes[device] -= entry.size
            if self._rows[device] <= 0:
                self._forget(device)
        WAITING.set(len(self))

    def forget(self, device: str) -> None:
        """Erase what waits of a device whose consent was withdrawn."""
        if device in self:
            with self._engine.begin() as connection:
                connection.execute(delete(SpoolRow).where(SpoolRow.device == device))
            self._forget(device)
            WAITING.set(len(self))

    def _forget(self, device: str) -> None:
        del self._rows[device]
        del self._bytes[device]
