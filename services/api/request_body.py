"""What clients send: read up to a bound, decoded, refused in words that name field, what was found, what is allowed."""

from __future__ import annotations

import re
from typing import Any, TypeVar

import msgspec
from fastapi import Request

from services.api.problems import Problem, ProblemError, invalid_value

__all__ = ["described", "invalid", "only_known", "read_body", "read_json", "read_object", "read_struct"]

S = TypeVar("S", bound=msgspec.Struct)
T = TypeVar("T")


def invalid(field: str, found: str, allowed: str) -> ProblemError:
    """Return the 422 for one value."""
    return ProblemError(invalid_value(field, found, allowed, f"{field}: {found}; allowed: {allowed}"))


async def read_body(request: Request, most: int) -> bytes:
    """Return the body.

    Raises:
        ProblemError: it is larger than ``most`` bytes.
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
    return bytes(body)


async def read_struct(request: Request, kind: type[S], most: int) -> S:
    """Return the body as a ``kind``; fields it does not know are passed over.

    Raises:
        ProblemError: it is larger than ``most`` bytes, or no ``kind``; the place inside the body is named.
    """
    body = await read_body(request, most)
    try:
        return msgspec.json.decode(body, type=kind)
    except msgspec.MsgspecError as error:
        words, _, place = str(error).partition(" - at `")
        field = place.rstrip("`").removeprefix("$.") if place else "body"
        raise invalid(field, words, "a JSON object as in the example at /docs") from error


def read_json(body: bytes, allowed: str) -> Any:
    """Return what JSON says, numbers finite and texts without control characters.

    Raises:
        ProblemError: it is no JSON, or holds what no text of ours may.
    """
    try:
        return msgspec.json.decode(body)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as reason:
        raise invalid("body", str(reason), allowed) from reason


def read_object(body: bytes, kind: type[T], allowed: str, ignored: frozenset[str] = frozenset()) -> T:
    """Return the body as a ``kind``, a Struct.

    Args:
        body: JSON.
        kind: what it must be.
        allowed: in words.
        ignored: fields that answers have and that mean nothing in a request.

    Raises:
        ProblemError: it is none; the field is named.
    """
    told = read_json(body, allowed)
    if not isinstance(told, dict):
        raise invalid("body", f"a {type(told).__name__}", allowed)
    return only_known({name: value for name, value in told.items() if name not in ignored}, kind, allowed)


def only_known(told: dict[str, Any], kind: type[T], allowed: str) -> T:
    """Return ``told`` as a ``kind``, a Struct all whose fields are known.

    Raises:
        ProblemError: a field is missing, unknown or wrong; it is named.
    """
    fields = {field.encode_name: field for field in msgspec.structs.fields(kind)}  # type: ignore[arg-type]
    for name in told:
        if name not in fields:
            raise invalid(name[:64], "a field that means nothing here", ", ".join(fields))
    for name, field in fields.items():
        if field.required and name not in told:
            raise invalid(name, "nothing", allowed)
    try:
        value = msgspec.convert(told, kind)
    except (msgspec.ValidationError, RecursionError) as reason:
        words, _, place = str(reason).partition(" - at ")
        raise invalid(place.strip("`").removeprefix("$.") or "body", words, allowed) from reason
    _only_printable(told, "")
    return value


def described(kind: type[Any], example: Any, media: str = "application/json") -> dict[str, Any]:
    """Return how the OpenAPI document describes a body that the route reads itself."""
    schema = {"$ref": f"#/components/schemas/{kind.__name__}"}
    return {"requestBody": {"required": True, "content": {media: {"schema": schema, "example": example}}}}


_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff]")


def _only_printable(value: Any, field: str) -> None:
    """Refuse what no database takes as text and no page should show."""
    if isinstance(value, str):
        if _CONTROL.search(value):
            raise invalid(field, "a control character", "printable text")
    elif isinstance(value, dict):
        for name, part in value.items():
            _only_printable(part, f"{field}.{name}".lstrip("."))
    elif isinstance(value, list):
        for part in value:
            _only_printable(part, field)
