"""What is stored of devices: the gateway's tables. The gateway is their one writer."""

from __future__ import annotations

from sqlalchemy import Float, ForeignKey, LargeBinary, String
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

__all__ = ["Base", "ConsentRow", "DeviceRow", "ErasureRow", "SpoolRow", "TokenRow", "TransmitterRow", "WalkerRow"]


class Base(DeclarativeBase):
    """The gateway's tables."""


class DeviceRow(Base):
    """One enrolled phone. After withdrawal only the id and the times remain."""

    __tablename__ = "gateway_devices"

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    token_sha256: Mapped[str | None] = mapped_column(String(64), unique=True)
    """Empty: of the time before tokens were signed."""
    name: Mapped[str] = mapped_column(String(64))
    platform: Mapped[str] = mapped_column(String(64))
    carrying: Mapped[str] = mapped_column(String(16))
    created: Mapped[float] = mapped_column(Float(53))
    revoked: Mapped[float | None] = mapped_column(Float(53))


class ConsentRow(Base):
    """When somebody agreed to which text, and when they took it back."""

    __tablename__ = "gateway_consents"

    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    device: Mapped[str] = mapped_column(ForeignKey("gateway_devices.id"), index=True)
    version: Mapped[str] = mapped_column(String(64))
    given: Mapped[float] = mapped_column(Float(53))
    withdrawn: Mapped[float | None] = mapped_column(Float(53))


class TokenRow(Base):
    """A token that was handed out, by its id; the token itself is stored nowhere."""

    __tablename__ = "gateway_tokens"

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    device: Mapped[str] = mapped_column(ForeignKey("gateway_devices.id"), index=True)
    scopes: Mapped[str] = mapped_column(String(128))
    created: Mapped[float] = mapped_column(Float(53))
    expires: Mapped[float] = mapped_column(Float(53))
    revoked: Mapped[float | None] = mapped_column(Float(53))


class TransmitterRow(Base):
    """What an enrolled carrier transmits with, as a keyed digest: the address itself is stored nowhere."""

    __tablename__ = "gateway_transmitters"

    digest: Mapped[str] = mapped_column(String(64), primary_key=True)
    device: Mapped[str] = mapped_column(ForeignKey("gateway_devices.id"), index=True)


class WalkerRow(Base):
    """What trial walks told of how somebody walks."""

    __tablename__ = "gateway_walkers"

    device: Mapped[str] = mapped_column(ForeignKey("gateway_devices.id"), primary_key=True)
    peak: Mapped[float | None] = mapped_column(Float(53))
    mean: Mapped[float | None] = mapped_column(Float(53))
    slope: Mapped[float | None] = mapped_column(Float(53))
    offset: Mapped[float | None] = mapped_column(Float(53))
    scale_variance: Mapped[float | None] = mapped_column(Float(53))
    created: Mapped[float] = mapped_column(Float(53))


class ErasureRow(Base):
    """A device withdrawn lately; each gateway process tells the bus of it once, for whoever was not there."""

    __tablename__ = "gateway_erasures"

    device: Mapped[str] = mapped_column(String(64), primary_key=True)
    withdrawn: Mapped[float] = mapped_column(Float(53))


class SpoolRow(Base):
    """A message that waits for the bus, acknowledged to its phone already."""

    __tablename__ = "gateway_spool"

    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    device: Mapped[str] = mapped_column(String(64), index=True)
    kind: Mapped[str] = mapped_column(String(16))
    payload: Mapped[bytes] = mapped_column(LargeBinary)
