"""History's database: SQLite by default, PostgreSQL by URL; opened, migrated, checked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sqlalchemy import Engine, event

from shared.database import Schema, open_engine

__all__ = ["SCHEMA", "VERSION_TABLE", "migrate", "open_history"]

VERSION_TABLE = "alembic_version_history"
SCHEMA = Schema("history", VERSION_TABLE, Path(__file__).parent / "migrations", setting="history_database_url")


def migrate(database_url: str) -> None:
    """Create history's tables or bring them up to date; what ``atrium migrate`` calls.

    Raises:
        ServiceError: the database cannot be reached or changed.
    """
    SCHEMA.migrate(database_url)


def open_history(database_url: str) -> Engine:
    """Return an engine of history's database; in SQLite what is deleted is overwritten.

    Raises:
        ServiceError: the URL is malformed, or its driver is not installed.
    """
    engine = open_engine(database_url, SCHEMA.setting)
    if engine.dialect.name == "sqlite":

        @event.listens_for(engine, "connect")
        def prepare(connection: Any, _record: object) -> None:
            cursor = connection.cursor()
            for pragma in ("secure_delete=ON", "synchronous=NORMAL", "cache_size=-65536"):
                cursor.execute(f"PRAGMA {pragma}")
            cursor.close()

    return engine
