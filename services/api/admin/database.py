"""The API's database: SQLite by default, PostgreSQL by URL; opened, migrated, checked."""

from __future__ import annotations

from pathlib import Path

from sqlalchemy import Engine

from shared.database import Schema, open_engine
from shared.runner import ServiceError

__all__ = ["SCHEMA", "VERSION_TABLE", "migrate", "open_admin"]

VERSION_TABLE = "alembic_version_api"
SCHEMA = Schema("api", VERSION_TABLE, Path(__file__).parent / "migrations", setting="api_database_url")


def migrate(database_url: str) -> None:
    """Create the API's tables or bring them up to date; what ``atrium migrate`` calls.

    Raises:
        ServiceError: the database cannot be reached or changed.
    """
    SCHEMA.migrate(database_url)


def open_admin(database_url: str) -> Engine:
    """Return an engine of the API's database, whose tables are as this program needs them.

    Raises:
        ServiceError: the URL is malformed, its driver is not installed, or the tables are not up to date.
    """
    engine = open_engine(database_url, SCHEMA.setting)
    problem = SCHEMA.problem(engine)
    if problem is not None:
        engine.dispose()
        raise ServiceError(problem)
    return engine
