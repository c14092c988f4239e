"""Does the route know what a query asks? A misspelt filter must not be no filter: what means nothing is refused."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, get_args, get_origin

from fastapi.dependencies.models import Dependant
from starlette.requests import HTTPConnection

from services.api.request_body import invalid

__all__ = ["only_known_queries"]


async def only_known_queries(connection: HTTPConnection) -> None:
    """Let a request of any route pass whose query holds only what the route declares, single values once.

    Raises:
        ProblemError: a parameter means nothing there; it is named, and so are those that do. Or one of which the route
            takes a single value has two: whichever were taken, the other would be ignored.
    """
    if not connection.scope["query_string"]:
        return
    allowed = dict(_declared(connection.scope["route"].dependant))
    for name in connection.query_params:
        if name not in allowed:
            raise invalid(name[:64], "a parameter that means nothing here", ", ".join(allowed) or "none")
        if len(connection.query_params.getlist(name)) > 1 and not _takes_several(allowed[name]):
            raise invalid(name, "given more than once", "one value")


def _declared(route: Dependant) -> Iterator[tuple[str, Any]]:
    """Yield name and type of every parameter."""
    for parameter in route.query_params:
        yield parameter.alias, parameter.field_info.annotation
    for part in route.dependencies:
        yield from _declared(part)


def _takes_several(kind: Any) -> bool:
    return list in {get_origin(part) for part in (kind, *get_args(kind))}
