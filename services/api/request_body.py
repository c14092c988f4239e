"""What clients send: read up to a bound, decoded, refused in words that name field, what was found, what is allowed."""

from __future__ import annotations

import asyncio
import re
from typing import Any, TypeVar

import msgspec
from fastapi import Request
from starlette.requests import ClientDisconnect

from services.api.problems import Problem, ProblemError, invalid_value

__all__ = ["described", "invalid", "only_known", "read_body", "read_json", "read_object", "read_struct", "sound"]

T = TypeVar("T")

PATIENCE = 10.0
"""Seconds for a body to come, and as many more as it takes at ``SLOWEST``."""
SLOWEST = 10_000.0
"""Bytes a second."""
DEEPEST = 50
"""Lists and objects within each other."""


def invalid(field: str, found: str, allowed: str) -> ProblemError:
    """Return the 422 for one value."""
    return ProblemError(invalid_value(field, found, allowed, f"{field}: {found}; allowed: {allowed}"))


async def read_body(request: Request, most: int) -> bytes:
    """Return the body.

    Raises:
        ProblemError: it is larger than ``most`` bytes (413), comes too slowly (408), or its sender went away (400).
    """
    body = bytearray()
    began = asyncio.get_running_loop().time()
    try:
        async with asyncio.timeout_at(began + PATIENCE) as deadline:
            async for chunk in request.stream():
                body += chunk
                if len(body) > most:
                    raise _bad_body(413, "Too large", f"more than {most} bytes", f"at most {most} bytes")
                deadline.reschedule(began + PATIENCE + len(body) / SLOWEST)
    except TimeoutError:
        allowed = f"all of it within {PATIENCE:g} s, or {SLOWEST:g} bytes a second"
        raise _bad_body(408, "Too slow", f"{len(body)} bytes and no end", allowed) from None
    except ClientDisconnect:
        raise _bad_body(400, "Broken off", f"{len(body)} bytes and no end", "all of it") from None
    return bytes(body)


async def read_struct(
    request: Request, kind: type[T], most: int, allowed: str = "a JSON object as in the example at /docs"
) -> T:
    """Return the body as a ``kind``, a Struct.

    Raises:
        ProblemError: see ``read_body`` and ``read_object``.
    """
    return read_object(await read_body(request, most), kind, allowed)


def read_json(body: bytes, allowed: str, shape: Any = Any) -> Any:
    """Return what JSON says, sound as of ``sound``; with a ``shape`` as one, and its raw parts are not looked into.

    Raises:
        ProblemError: it is no JSON, or holds what no text of ours may.
    """
    try:
        if shape is not Any:
            body.decode()  # parts that are not looked into are text, too
        told = msgspec.json.decode(body, type=shape)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as reason:
        raise invalid("body", str(reason), allowed) from reason
    return sound(told) if shape is Any else told


def read_object(body: bytes, kind: type[T], allowed: str) -> T:
    """Return the body as a ``kind``, a Struct.

    Args:
        body: JSON.
        kind: what it must be.
        allowed: in words.

    Raises:
        ProblemError: it is none; the field is named.
    """
    told = read_json(body, allowed)
    if not isinstance(told, dict):
        raise invalid("body", f"a {type(told).__name__}", allowed)
    return only_known(told, kind, allowed)


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
        return msgspec.convert(told, kind)
    except msgspec.ValidationError as reason:
        words, _, place = str(reason).partition(" - at ")
        raise invalid(place.strip("`").removeprefix("$.") or "body", words, allowed) from reason


def described(kind: type[Any], example: Any, media: str = "application/json") -> dict[str, Any]:
    """Return how the OpenAPI document describes a body that the route reads itself."""
    schema = {"$ref": f"#/components/schemas/{kind.__name__}"}
    return {"requestBody": {"required": True, "content": {media: {"schema": schema, "example": example}}}}


_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""What no database takes as text, no page should show, or lets a text show in another order than it is written in."""


def sound(told: T) -> T:
    """Return what was decoded, unless a text in it holds a control character or it is too deep.

    Raises:
        ProblemError: it does; the field is named.
    """
    waiting: list[tuple[str, int, Any]] = [("", 0, told)]
    while waiting:
        field, depth, value = waiting.pop()
        if isinstance(value, str):
            if _CONTROL.search(value):
                raise invalid(field[:64] or "body", "a control character", "printable text, its order as it is written")
        elif isinstance(value, dict | list):
            if depth == DEEPEST:
                raise invalid(field[:64] or "body", f"more than {DEEPEST} lists and objects within each other", "fewer")
            named = isinstance(value, dict)
            parts = value.items() if isinstance(value, dict) else ((field, part) for part in value)
            for name, part in parts:
                if isinstance(part, str | dict | list):
                    waiting.append((f"{field}.{name}".lstrip(".") if named else name, depth + 1, part))
    return told


def _bad_body(status: int, title: str, found: str, allowed: str) -> ProblemError:
    """Return the refusal of a body that did not come as a whole."""
    return ProblemError(
        Problem(
            type="urn:atrium:" + title.lower().replace(" ", "-"),
            title=title,
            status=status,
            detail=f"body: {found}; allowed: {allowed}",
            field="body",
            found=found,
            allowed=allowed,
        ),
        {"Connection": "close"} if status == 408 else None,
    )
