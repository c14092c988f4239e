"""The database of alerts and webhooks: SQLite by default, PostgreSQL by URL; opened, migrated, checked."""

from __future__ import annotations

from pathlib import Path

from sqlalchemy import Engine

from shared.database import Schema, open_engine

__all__ = ["SCHEMA", "VERSION_TABLE", "migrate", "open_alerts"]

VERSION_TABLE = "alembic_version_api_alerts"
SCHEMA = Schema("api (alerts)", VERSION_TABLE, Path(__file__).parent / "migrations", setting="api_database_url")


def migrate(database_url: str) -> None:
    """Create the tables or bring them up to date; what ``atrium migrate`` calls.

    Raises:
        ServiceError: the database cannot be reached or changed.
    """
    SCHEMA.migrate(database_url)


def open_alerts(database_url: str) -> Engine:
    """Return an engine of the database.

    Raises:
        ServiceError: the URL is malformed, or its driver is not installed.
    """
    return open_engine(database_url, SCHEMA.setting)
