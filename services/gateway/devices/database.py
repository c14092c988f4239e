"""The gateway's database: SQLite by default, PostgreSQL by ``ATRIUM_DATABASE_URL``; opened, migrated, checked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Engine, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError, SQLAlchemyError

from shared.runner import ServiceError

__all__ = ["VERSION_TABLE", "migrate", "open_engine", "schema_problem"]

VERSION_TABLE = "alembic_version_gateway"
_MIGRATIONS = Path(__file__).parents[1] / "migrations"


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


def migrate(database_url: str, version: str = "head") -> None:
    """Create the gateway's tables or bring them up to date; what ``atrium migrate`` calls.

    Args:
        database_url: which database.
        version: to which schema; the newest by default.

    Raises:
        ServiceError: the database cannot be reached or changed.
    """
    engine = open_engine(database_url)
    try:
        with engine.begin() as connection:
            config = _alembic()
            config.attributes["connection"] = connection
            command.upgrade(config, version)
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
