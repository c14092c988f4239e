"""Read a request's JSON body into a Struct; what is wrong is told as a problem that names field, found and allowed."""

from __future__ import annotations

from typing import Any, TypeVar

import msgspec
from fastapi import Request

from services.api.problems import Problem, ProblemError

__all__ = ["described_body", "invalid", "read_body"]

S = TypeVar("S", bound=msgspec.Struct)


def described_body(kind: type[msgspec.Struct], example: dict[str, Any]) -> dict[str, Any]:
    """Return how the OpenAPI document describes a body that the route reads itself (``openapi_extra``)."""
    schema = {"$ref": f"#/components/schemas/{kind.__name__}"}
    return {"requestBody": {"required": True, "content": {"application/json": {"schema": schema, "example": example}}}}


async def read_body(request: Request, kind: type[S], most: int) -> S:
    """Return the body of at most ``most`` bytes as a ``kind``.

    Raises:
        ProblemError: 413, or 422 with the place inside the body.
    """
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > most:
            raise ProblemError(
                Problem(
                    type="urn:atrium:too-large",
                    title="Too large",
                    status=413,
                    detail=f"the body is larger than {most} bytes",
                    field="body",
                    found=f"more than {most} bytes",
                    allowed=f"at most {most} bytes",
                )
            )
    try:
        return msgspec.json.decode(bytes(body), type=kind)
    except msgspec.MsgspecError as error:
        words, _, place = str(error).partition(" - at `")
        field = place.rstrip("`").removeprefix("$.") if place else "body"
        raise invalid(field, words, "a JSON object as in the example at /docs") from error


def invalid(field: str, found: str, allowed: str) -> ProblemError:
    """Return the 422 for a value that cannot be used."""
    return ProblemError(
        Problem(
            type="urn:atrium:invalid-value",
            title="Invalid value",
            status=422,
            detail=f"{field}: {found}; allowed: {allowed}",
            field=field,
            found=found,
            allowed=allowed,
        )
    )
