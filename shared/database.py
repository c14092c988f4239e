"""A service's tables: SQLite by default, PostgreSQL by URL; opened, migrated by Alembic, checked.

Services may share one database: each has its own tables, and its own table that says at which version they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Engine, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError, SQLAlchemyError

from shared.runner import ServiceError

__all__ = ["Schema", "open_engine", "unreachable"]


def open_engine(database_url: str, setting: str = "database_url") -> Engine:
    """Return an engine; SQLite in write-ahead mode, so that readers never wait for the writer.

    Args:
        database_url: which database.
        setting: what the URL came from, for the message.

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
            f"{setting}: {error}; allowed: sqlite:///FILE or postgresql://USER:PASSWORD@HOST/NAME"
        ) from error
    if engine.dialect.name == "sqlite":

        @event.listens_for(engine, "connect")
        def prepare(connection: Any, _record: object) -> None:
            cursor = connection.cursor()
            for pragma in ("journal_mode=WAL", "foreign_keys=ON", "busy_timeout=5000"):
                cursor.execute(f"PRAGMA {pragma}")
            cursor.close()

    return engine


def unreachable(engine: Engine, error: SQLAlchemyError) -> str:
    """Say in one line what is wrong with a database, its password hidden."""
    reason = str(getattr(error, "orig", None) or error).splitlines()[0]
    return f"database {engine.url.render_as_string(hide_password=True)}: {reason}"


@dataclass(frozen=True)
class Schema:
    """The tables of one service.

    Attributes:
        service: its name.
        version_table: where Alembic keeps the version of its tables.
        migrations: the folder of its versions.
        setting: the setting its URL comes from.
    """

    service: str
    version_table: str
    migrations: Path
    setting: str = "database_url"

    def migrate(self, database_url: str, version: str = "head") -> None:
        """Create the tables or bring them up to ``version``.

        Raises:
            ServiceError: the database cannot be reached or changed.
        """
        engine = open_engine(database_url, self.setting)
        try:
            with engine.begin() as connection:
                config = self._alembic()
                config.attributes["connection"] = connection
                command.upgrade(config, version)
        except SQLAlchemyError as error:
            raise ServiceError(unreachable(engine, error)) from error
        finally:
            engine.dispose()

    def problem(self, engine: Engine) -> str | None:
        """Return in one line why the tables cannot be used, or None.

        Raises:
            ServiceError: the database cannot be reached.
        """
        wanted = ScriptDirectory.from_config(self._alembic()).get_current_head()
        options = {"version_table": self.version_table}
        try:
            with engine.connect() as connection:
                found = MigrationContext.configure(connection, opts=options).get_current_revision()
        except SQLAlchemyError as error:
            raise ServiceError(unreachable(engine, error)) from error
        if found == wanted:
            return None
        none = f"has no {self.service} tables"
        state = none if found is None else f"is at version {found}, this program needs {wanted}"
        return f"the database {engine.url.render_as_string(hide_password=True)} {state}: run `atrium migrate` first"

    def _alembic(self) -> Config:
        config = Config()
        config.set_main_option("script_location", str(self.migrations).replace("%", "%%"))
        return config
