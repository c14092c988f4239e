"""What a client is told when the database does not answer: try again, in one shape for all routes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import structlog
from sqlalchemy import Engine
from sqlalchemy.exc import SQLAlchemyError

from services.api.problems import Problem, ProblemError
from shared.database import unreachable

__all__ = ["storage_away"]

log = structlog.get_logger(__name__)


@contextmanager
def storage_away(engine: Engine) -> Iterator[None]:
    """Turn what a database raises into the 503 that clients get.

    Raises:
        ProblemError: the database does not do what it is asked.
    """
    try:
        yield
    except SQLAlchemyError as error:
        log.warning("not answered: the database is away", reason=unreachable(engine, error))
        raise ProblemError(
            Problem(
                type="urn:atrium:storage-away",
                title="The database is away",
                status=503,
                detail="alerts and webhooks cannot be read or changed now; positions and streams do not depend on it",
            ),
            {"Retry-After": "5"},
        ) from error
