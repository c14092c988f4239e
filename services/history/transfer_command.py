"""Export and import by the URL of a database, whatever is wrong said in one line; what ``atrium history`` calls."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from sqlalchemy import Engine
from sqlalchemy.exc import SQLAlchemyError

from services.history.database import SCHEMA, open_history
from services.history.settings import default_history_database_url
from services.history.transfer import TransferError, export_history, import_history
from shared.database import unreachable
from shared.runner import ServiceError

__all__ = ["export_to", "import_from"]


def export_to(database_url: str | None, out: Path, since: float | None, until: float | None, device: str | None) -> int:
    """Write what is kept into a file and return how many rows.

    Raises:
        ServiceError: the database cannot be read, or has no tables.
        OSError: the file cannot be written.
    """
    return _with(database_url, lambda engine: export_history(engine, out, since, until, device))


def import_from(database_url: str | None, source: Path) -> int:
    """Bring a file in and return how many rows.

    Raises:
        ServiceError: the database cannot be written, has no tables, or the file holds what cannot be.
        OSError: the file cannot be read.
    """
    return _with(database_url, lambda engine: import_history(engine, source))


def _with(database_url: str | None, work: Callable[[Engine], int]) -> int:
    engine = open_history(database_url or default_history_database_url())
    try:
        problem = SCHEMA.problem(engine)
        if problem is not None:
            raise ServiceError(problem)
        return work(engine)
    except TransferError as error:
        raise ServiceError(str(error)) from error
    except SQLAlchemyError as error:
        raise ServiceError(unreachable(engine, error)) from error
    finally:
        engine.dispose()
