"""What a client is told when the API's database does not answer: try again, in one shape for all routes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import structlog
from sqlalchemy import Engine
from sqlalchemy.exc import SQLAlchemyError

from services.api.problems import Problem, ProblemError
from shared.database import unreachable

__all__ = ["database_away"]

log = structlog.get_logger(__name__)


@contextmanager
def database_away(engine: Engine) -> Iterator[None]:
    """Turn what a database raises into the 503 that clients get; why stands in the log.

    Raises:
        ProblemError: the database does not do what it is asked.
    """
    try:
        yield
    except SQLAlchemyError as error:
        log.warning("not answered: the database is away", reason=unreachable(engine, error))
        raise ProblemError(
            Problem(
                type="urn:atrium:database-away",
                title="Database away",
                status=503,
                detail="the API's database cannot be reached now, nothing was changed; positions and streams go on",
            ),
            {"Retry-After": "5"},
        ) from error
