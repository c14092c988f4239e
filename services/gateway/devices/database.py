"""The gateway's database: SQLite by default, PostgreSQL by ``ATRIUM_DATABASE_URL``; opened, migrated, checked."""

from __future__ import annotations

from pathlib import Path

from sqlalchemy import Engine

from shared.database import Schema, open_engine

__all__ = ["VERSION_TABLE", "migrate", "open_engine", "schema_problem"]

VERSION_TABLE = "alembic_version_gateway"
_SCHEMA = Schema("gateway", VERSION_TABLE, Path(__file__).parents[1] / "migrations")


def migrate(database_url: str, version: str = "head") -> None:
    """Create the gateway's tables or bring them up to date; what ``atrium migrate`` calls.

    Args:
        database_url: which database.
        version: to which schema; the newest by default.

    Raises:
        ServiceError: the database cannot be reached or changed.
    """
    _SCHEMA.migrate(database_url, version)


def schema_problem(engine: Engine) -> str | None:
    """Return in one line why the tables cannot be used, or None.

    Raises:
        ServiceError: the database cannot be reached.
    """
    return _SCHEMA.problem(engine)
