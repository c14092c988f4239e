"""Devices and consents in the database: SQLite by default, PostgreSQL by ``ATRIUM_DATABASE_URL``.

Tokens are kept as SHA-256 only. The gateway is the one writer of these tables.
"""

from __future__ import annotations

import hashlib
import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Engine, Float, ForeignKey, LargeBinary, String, create_engine, event, make_url, select, update
from sqlalchemy.exc import ArgumentError, SQLAlchemyError
from sqlalchemy.orm import DeclarativeBase, Mapped, Session, mapped_column

from shared.runner import ServiceError

__all__ = ["VERSION_TABLE", "Base", "DeviceStore", "Registered", "migrate", "open_engine", "schema_problem"]

VERSION_TABLE = "alembic_version_gateway"
_MIGRATIONS = Path(__file__).parents[1] / "migrations"


class Base(DeclarativeBase):
    """The gateway's tables."""


class DeviceRow(Base):
    """One enrolled phone. After withdrawal only the id and the times remain."""

    __tablename__ = "gateway_devices"

    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    token_sha256: Mapped[str | None] = mapped_column(String(64), unique=True)
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
    created: Mapped[float] = mapped_column(Float(53))


class SpoolRow(Base):
    """A message that waits for the bus, acknowledged to its phone already."""

    __tablename__ = "gateway_spool"

    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    device: Mapped[str] = mapped_column(String(64), index=True)
    kind: Mapped[str] = mapped_column(String(16))
    payload: Mapped[bytes] = mapped_column(LargeBinary)


@dataclass(frozen=True, slots=True)
class Registered:
    """A device that may post."""

    id: str
    carrying: str


class DeviceStore:
    """Enrolled devices. Every method is one transaction and may be called from any thread."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def enrol(self, now: float, version: str, name: str, platform: str, carrying: str) -> tuple[Registered, str]:
        """Store a new device with its consent; return it and its token, which is stored nowhere."""
        device = Registered(f"d-{secrets.token_hex(8)}", carrying)
        token = secrets.token_urlsafe(32)
        with Session(self._engine) as session, session.begin():
            session.add(
                DeviceRow(
                    id=device.id,
                    token_sha256=_digest(token),
                    name=name,
                    platform=platform,
                    carrying=carrying,
                    created=now,
                    revoked=None,
                )
            )
            session.flush()
            session.add(ConsentRow(device=device.id, version=version, given=now, withdrawn=None))
        return device, token

    def by_token(self, token: str) -> Registered | None:
        """Return the device this token belongs to."""
        query = select(DeviceRow.id, DeviceRow.carrying).where(
            DeviceRow.token_sha256 == _digest(token), DeviceRow.revoked.is_(None)
        )
        with Session(self._engine) as session:
            row = session.execute(query).one_or_none()
        return None if row is None else Registered(row.id, row.carrying)

    def exists(self, device: str) -> bool:
        """Whether a device of this id is enrolled now."""
        query = select(DeviceRow.id).where(DeviceRow.id == device, DeviceRow.revoked.is_(None))
        with Session(self._engine) as session:
            return session.execute(query).one_or_none() is not None

    def withdraw(self, device: str, now: float) -> None:
        """Take the consent back: the token dies, what the phone said of itself is deleted, the times stay as proof."""
        with Session(self._engine) as session, session.begin():
            session.execute(
                update(DeviceRow)
                .where(DeviceRow.id == device)
                .values(token_sha256=None, name="", platform="", revoked=now)
            )
            session.execute(
                update(ConsentRow)
                .where(ConsentRow.device == device, ConsentRow.withdrawn.is_(None))
                .values(withdrawn=now)
            )


def open_engine(database_url: str) -> Engine:
    """Return an engine; SQLite in write-ahead mode, so that readers never wait for the writer.

    Raises:
        ServiceError: the URL is malformed, or its driver is not installed.
    """
    try:
        url = make_url(database_url)
        if url.get_backend_name() == "postgresql" and "+" not in url.drivername:
            url = url.set(drivername="postgresql+psycopg")
        engine = create_engine(url, pool_pre_ping=True)
    except (ArgumentError, ImportError) as error:
        raise ServiceError(
            f"database_url: {error}; allowed: sqlite:///FILE or postgresql://USER:PASSWORD@HOST/NAME"
        ) from error
    if engine.dialect.name == "sqlite":

        @event.listens_for(engine, "connect")
        def prepare(connection: Any, _record: object) -> None:
            cursor = connection.cursor()
            for pragma in ("journal_mode=WAL", "foreign_keys=ON", "busy_timeout=5000"):
                cursor.execute(f"PRAGMA {pragma}")
            cursor.close()

    return engine


def migrate(database_url: str) -> None:
    """Create the gateway's tables or bring them up to date; what ``atrium migrate`` calls.

    Raises:
        ServiceError: the database cannot be reached or changed.
    """
    engine = open_engine(database_url)
    try:
        with engine.begin() as connection:
            config = _alembic()
            config.attributes["connection"] = connection
            command.upgrade(config, "head")
    except SQLAlchemyError as error:
        raise ServiceError(_unreachable(engine, error)) from error
    finally:
        engine.dispose()


def schema_problem(engine: Engine) -> str | None:
    """Return in one line why the tables cannot be used, or None.

    Raises:
        ServiceError: the database cannot be reached.
    """
    wanted = ScriptDirectory.from_config(_alembic()).get_current_head()
    try:
        with engine.connect() as connection:
            found = MigrationContext.configure(connection, opts={"version_table": VERSION_TABLE}).get_current_revision()
    except SQLAlchemyError as error:
        raise ServiceError(_unreachable(engine, error)) from error
    if found == wanted:
        return None
    state = "has no gateway tables" if found is None else f"is at version {found}, this program needs {wanted}"
    return f"the database {engine.url.render_as_string(hide_password=True)} {state}: run `atrium migrate` first"


def _unreachable(engine: Engine, error: SQLAlchemyError) -> str:
    reason = str(getattr(error, "orig", None) or error).splitlines()[0]
    return f"database {engine.url.render_as_string(hide_password=True)}: {reason}"


def _alembic() -> Config:
    config = Config()
    config.set_main_option("script_location", str(_MIGRATIONS).replace("%", "%%"))
    return config


def _digest(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()
