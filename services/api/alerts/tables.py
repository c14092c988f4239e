"""What is stored of alerts and webhooks. The API is their one writer."""

from __future__ import annotations

from sqlalchemy import BigInteger, Float, ForeignKey, Index, LargeBinary, String, Text, text
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

__all__ = ["LONGEST_ID", "LONGEST_REASON", "AlertRow", "Base", "DeliveryRow", "EventNumberRow", "WebhookRow"]

LONGEST_ID = 200
LONGEST_REASON = 300


class Base(DeclarativeBase):
    """The tables of alerts and webhooks."""


_noted = Index("ix_api_alerts_noted", "seq", sqlite_where=text("note != ''"), postgresql_where=text("note != ''"))
"""Few alerts have a note; to look through them for a phone is not to look through all."""


class AlertRow(Base):
    """One alert; ``seq`` counts them as they came."""

    __tablename__ = "api_alerts"
    __table_args__ = (Index("ix_api_alerts_zone", "zone", "t"), _noted, {"sqlite_autoincrement": True})

    seq: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(String(LONGEST_ID), unique=True)
    t: Mapped[float] = mapped_column(Float(53), index=True)
    sent: Mapped[float] = mapped_column(Float(53), index=True)
    """Wall clock at which it was told; of a recording that is played, ``t`` is long ago."""
    zone: Mapped[str] = mapped_column(String(64))
    kind: Mapped[str] = mapped_column(String(16))
    area: Mapped[str] = mapped_column(String(64))
    device: Mapped[str | None] = mapped_column(String(64), index=True)
    other_device: Mapped[str | None] = mapped_column(String(64), index=True)
    event: Mapped[int] = mapped_column(BigInteger, index=True)
    """Of the event log, under which streams told it."""
    told: Mapped[bytes] = mapped_column(LargeBinary)
    """The alert as the bus carried it, JSON, without erased devices."""
    acknowledged: Mapped[float | None] = mapped_column(Float(53), index=True)
    acknowledged_by: Mapped[str] = mapped_column(String(LONGEST_ID), default="")
    note: Mapped[str] = mapped_column(Text, default="")


class WebhookRow(Base):
    """Whom alerts are sent to."""

    __tablename__ = "api_webhooks"

    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    name: Mapped[str] = mapped_column(String(200))
    url: Mapped[str] = mapped_column(String(2000))
    kinds: Mapped[str] = mapped_column(Text)
    """JSON list; empty: all. ``zones`` likewise."""
    zones: Mapped[str] = mapped_column(Text)
    enabled: Mapped[bool]
    secret: Mapped[str] = mapped_column(String(100))
    created: Mapped[float] = mapped_column(Float(53))
    created_by: Mapped[str] = mapped_column(String(LONGEST_ID))
    delivered: Mapped[int] = mapped_column(default=0)
    failed: Mapped[int] = mapped_column(default=0)
    """Attempts."""
    last_success: Mapped[float | None] = mapped_column(Float(53))
    last_failure: Mapped[float | None] = mapped_column(Float(53))
    last_reason: Mapped[str] = mapped_column(String(LONGEST_REASON), default="")


class DeliveryRow(Base):
    """One alert or trouble that one webhook has yet to be sent, or (``dead``) that it never took. What was taken
    has no row.
    """

    __tablename__ = "api_deliveries"
    __table_args__ = (Index("ix_api_deliveries_due", "webhook", "dead", "due"), {"sqlite_autoincrement": True})

    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    webhook: Mapped[str] = mapped_column(ForeignKey("api_webhooks.id", ondelete="CASCADE"))
    alert: Mapped[int | None] = mapped_column(ForeignKey("api_alerts.seq", ondelete="CASCADE"), index=True)
    trouble: Mapped[bytes | None] = mapped_column(LargeBinary)
    """Where it is no alert: the ``Trouble``, JSON."""
    dead: Mapped[bool] = mapped_column(default=False)
    attempts: Mapped[int] = mapped_column(default=0)
    due: Mapped[float] = mapped_column(Float(53))
    """Wall clock of the next attempt; of a dead one, when it died."""
    reason: Mapped[str] = mapped_column(String(LONGEST_REASON), default="")
    """Why the last attempt failed."""


class EventNumberRow(Base):
    """Up to which id events may have been told; one row."""

    __tablename__ = "api_event_numbers"

    id: Mapped[int] = mapped_column(primary_key=True)
    reserved: Mapped[int] = mapped_column(BigInteger)
