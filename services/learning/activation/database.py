"""Learning's database: SQLite by default, PostgreSQL by URL; opened, migrated, checked."""

from __future__ import annotations

from pathlib import Path

from sqlalchemy import Engine, create_engine
from sqlalchemy.pool import StaticPool

from services.learning.activation.tables import Base
from shared.database import Schema, open_engine

__all__ = ["SCHEMA", "VERSION_TABLE", "in_memory", "migrate", "open_learning"]

VERSION_TABLE = "alembic_version_learning"
SCHEMA = Schema("learning", VERSION_TABLE, Path(__file__).parents[1] / "migrations", setting="learning_database_url")


def migrate(database_url: str) -> None:
    """Create learning's tables or bring them up to date; what ``atrium migrate`` calls.

    Raises:
        ServiceError: the database cannot be reached or changed.
    """
    SCHEMA.migrate(database_url)


def open_learning(database_url: str) -> Engine:
    """Return an engine of learning's database.

    Raises:
        ServiceError: the URL is malformed, or its driver is not installed.
    """
    return open_engine(database_url, SCHEMA.setting)


def in_memory() -> Engine:
    """Return an engine with the tables that nobody else sees and that is gone with the process, for experiments."""
    engine = create_engine("sqlite://", poolclass=StaticPool, connect_args={"check_same_thread": False})
    Base.metadata.create_all(engine)
    return engine
