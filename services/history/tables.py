"""What is stored of the past: history's tables. History is their one writer.

Text columns have no length: what comes over the bus is checked where it is taken, and a database must never refuse it.
"""

from __future__ import annotations

from sqlalchemy import BigInteger, Float, Index, Integer, LargeBinary, Text
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

__all__ = ["AlertRow", "AppliedRow", "Base", "BlockRow", "ErasedRow", "OccupancyRow"]

_Key = BigInteger().with_variant(Integer, "sqlite")
"""SQLite numbers rows by itself only where the key is an INTEGER."""


class Base(DeclarativeBase):
    """History's tables."""


class BlockRow(Base):
    """Where one subject was on one floor in one minute."""

    __tablename__ = "history_blocks"
    __table_args__ = (
        Index("ix_history_blocks_of", "kind", "subject", "minute", "area", "floor", unique=True),
        Index("ix_history_blocks_minute", "kind", "minute"),
    )

    id: Mapped[int] = mapped_column(_Key, primary_key=True, autoincrement=True)
    kind: Mapped[str] = mapped_column(Text)
    """track or device."""
    subject: Mapped[str] = mapped_column(Text)
    minute: Mapped[int] = mapped_column(BigInteger)
    """Since the epoch."""
    area: Mapped[str] = mapped_column(Text)
    floor: Mapped[str] = mapped_column(Text)
    step: Mapped[float] = mapped_column(Float(53))
    """Seconds each point stands for."""
    points: Mapped[bytes] = mapped_column(LargeBinary)
    """As ``services.history.blocks`` packs them."""
    tracks: Mapped[str] = mapped_column(Text, default="", server_default="")
    """Of a device: which tracks carried it, as ``services.history.persons.carried_by`` writes it."""


class AlertRow(Base):
    """One alert."""

    __tablename__ = "history_alerts"
    __table_args__ = (Index("ix_history_alerts_t", "t"),)

    id: Mapped[str] = mapped_column(Text, primary_key=True)
    t: Mapped[float] = mapped_column(Float(53))
    zone: Mapped[str] = mapped_column(Text)
    kind: Mapped[str] = mapped_column(Text)
    device: Mapped[str | None] = mapped_column(Text, index=True)
    other_device: Mapped[str | None] = mapped_column(Text, index=True)
    told: Mapped[str] = mapped_column(Text)
    """The message, JSON, without the devices' names."""


class OccupancyRow(Base):
    """How many people were at one place in one minute."""

    __tablename__ = "history_occupancy"
    __table_args__ = (Index("ix_history_occupancy_minute", "minute"),)

    kind: Mapped[str] = mapped_column(Text, primary_key=True)
    """zone or area."""
    place: Mapped[str] = mapped_column(Text, primary_key=True)
    minute: Mapped[int] = mapped_column(BigInteger, primary_key=True, autoincrement=False)
    counts: Mapped[int]
    """How often it was counted; the sums are over these."""
    people: Mapped[int] = mapped_column(BigInteger)
    most: Mapped[int]
    phones: Mapped[int] = mapped_column(BigInteger)


class ErasedRow(Base):
    """A device that withdrew its consent: nothing of it is stored any more, wherever it comes from."""

    __tablename__ = "history_erased"

    device: Mapped[str] = mapped_column(Text, primary_key=True)
    t: Mapped[float] = mapped_column(Float(53))


class AppliedRow(Base):
    """A file of the spool that is in the database, though its file may not be gone yet: it is not to count twice."""

    __tablename__ = "history_applied"

    name: Mapped[str] = mapped_column(Text, primary_key=True)
