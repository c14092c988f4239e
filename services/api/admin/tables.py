"""What the API stores: its own tables. One process of the API is their one writer."""

from __future__ import annotations

from sqlalchemy import BigInteger, Float, Integer, String, Text
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

__all__ = ["AuditRow", "Base", "CatalogueRow", "DefinitionRow", "KeyRow", "SessionRow", "UserRow"]


class Base(DeclarativeBase):
    """The API's tables."""


class CatalogueRow(Base):
    """How often a kind of definition was changed; no row: never, and the site file rules."""

    __tablename__ = "api_catalogues"

    kind: Mapped[str] = mapped_column(String(16), primary_key=True)
    version: Mapped[int] = mapped_column(BigInteger)


class DefinitionRow(Base):
    """One zone or exhibit."""

    __tablename__ = "api_definitions"

    kind: Mapped[str] = mapped_column(String(16), primary_key=True)
    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    place: Mapped[int] = mapped_column(BigInteger)
    """Its place in the list."""
    body: Mapped[str] = mapped_column(Text)
    """The definition, JSON."""


class KeyRow(Base):
    """One key that was issued; of the secret only its digest."""

    __tablename__ = "api_keys"

    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    name: Mapped[str] = mapped_column(String(64))
    digest: Mapped[str] = mapped_column(String(64), unique=True)
    scopes: Mapped[str] = mapped_column(Text)
    """Separated by blanks."""
    rate: Mapped[float] = mapped_column(Float(53))
    """Requests per second."""
    created: Mapped[float] = mapped_column(Float(53))
    expires: Mapped[float | None] = mapped_column(Float(53))
    last_used: Mapped[float | None] = mapped_column(Float(53))
    """To the hour."""


class UserRow(Base):
    """One of the staff; of the password only its hash."""

    __tablename__ = "api_users"

    name: Mapped[str] = mapped_column(String(64), primary_key=True)
    role: Mapped[str] = mapped_column(String(16))
    password: Mapped[str] = mapped_column(String(256))
    created: Mapped[float] = mapped_column(Float(53))


class SessionRow(Base):
    """One sign-in; of the token only its digest."""

    __tablename__ = "api_sessions"

    digest: Mapped[str] = mapped_column(String(64), primary_key=True)
    user: Mapped[str] = mapped_column(String(64), index=True)
    created: Mapped[float] = mapped_column(Float(53))
    expires: Mapped[float] = mapped_column(Float(53))


class AuditRow(Base):
    """Somebody changed something or looked somebody up."""

    __tablename__ = "api_audit"

    id: Mapped[int] = mapped_column(BigInteger().with_variant(Integer, "sqlite"), primary_key=True, autoincrement=True)
    t: Mapped[float] = mapped_column(Float(53), index=True)
    who: Mapped[str] = mapped_column(String(128))
    action: Mapped[str] = mapped_column(String(16))
    """The method of the request."""
    subject: Mapped[str] = mapped_column(String(512))
    """The path of the request, or of what it made."""
    status: Mapped[int]
    times: Mapped[int]
    """How often within a minute, of look-ups; within an hour, of reads that name whomever there is."""
    detail: Mapped[str] = mapped_column(Text)
