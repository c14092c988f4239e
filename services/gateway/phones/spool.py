"""What waits for the bus though it is acknowledged to its phone: in the database, in order, over a restart."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from prometheus_client import Gauge
from sqlalchemy import Engine, delete, func, insert, select

from services.gateway.devices.tables import SpoolRow
from shared.messages import MotionBatch, RadioScan, decode, encode

__all__ = ["Spool", "SpoolFullError", "Spooled"]

WAITING = Gauge("atrium_gateway_spooled", "Messages that wait in the database for the bus")
_KINDS: dict[str, type[RadioScan] | type[MotionBatch]] = {"radio": RadioScan, "motion": MotionBatch}


class SpoolFullError(RuntimeError):
    """No more fits; nothing was stored."""


@dataclass(frozen=True, slots=True)
class Spooled:
    """One message that waits."""

    id: int
    message: RadioScan | MotionBatch
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
        query = select(SpoolRow.id, SpoolRow.kind, SpoolRow.payload).order_by(SpoolRow.id).limit(most)
        with self._engine.connect() as connection:
            rows = connection.execute(query).all()
        return [Spooled(row.id, decode(row.payload, _KINDS[row.kind]), len(row.payload)) for row in rows]

    def drop(self, published: Sequence[Spooled]) -> None:
        """Forget the oldest messages, which are on the bus."""
        with self._engine.begin() as connection:
            connection.execute(delete(SpoolRow).where(SpoolRow.id <= published[-1].id))
        for entry in published:
            device = entry.message.device
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
