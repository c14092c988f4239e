"""Does the route know what a query asks? A misspelt filter must not be no filter: what means nothing is refused."""

from __future__ import annotations

from collections.abc import Iterator

from fastapi.dependencies.models import Dependant
from starlette.requests import HTTPConnection

from services.api.request_body import invalid

__all__ = ["only_known_queries"]


async def only_known_queries(connection: HTTPConnection) -> None:
    """Let a request of any route pass whose query holds only parameters that the route declares.

    Raises:
        ProblemError: one means nothing there; it is named, and so are those that do.
    """
    if not connection.scope["query_string"]:
        return
    allowed = list(_declared(connection.scope["route"].dependant))
    for name in connection.query_params:
        if name not in allowed:
            raise invalid(name[:64], "a parameter that means nothing here", ", ".join(allowed) or "none")


def _declared(route: Dependant) -> Iterator[str]:
    yield from (parameter.alias for parameter in route.query_params)
    for part in route.dependencies:
        yield from _declared(part)
