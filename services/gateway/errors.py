"""What is wrong with a request, in one form: status and a list of fields with what was found and what is allowed."""

from __future__ import annotations

import json
import math
import re
from typing import Any, NoReturn, TypeVar

import msgspec

from services.gateway.protocol import ErrorReply, FieldError

__all__ = ["RequestError", "plain", "read_json", "refuse"]

S = TypeVar("S", bound=msgspec.Struct)

LONGEST_NAME, LONGEST_VALUE = 200, 80
"""Characters that are told of a field's name and of its value."""

_decoders: dict[type[msgspec.Struct], msgspec.json.Decoder[Any]] = {}


class RequestError(Exception):
    """A request is refused: the HTTP status and what is wrong, field by field."""

    def __init__(self, status: int, *problems: FieldError, headers: dict[str, str] | None = None) -> None:
        super().__init__("; ".join(f"{p.field}: {p.problem}" for p in problems))
        self.status = status
        self.headers = headers or {}
        wait = self.headers.get("Retry-After")
        self.reply = ErrorReply(status=status, detail=list(problems), retry_after=None if wait is None else float(wait))


def refuse(field: str, problem: str, found: object = "", allowed: str = "", status: int = 422) -> NoReturn:
    """Raise a RequestError about one field."""
    text = found if isinstance(found, str) else repr(found)
    shown = plain(text, LONGEST_VALUE)
    problem = plain(problem, LONGEST_NAME)
    raise RequestError(
        status, FieldError(field=plain(field, LONGEST_NAME), problem=problem, found=shown, allowed=allowed)
    )


def plain(text: str, longest: int) -> str:
    """Return text as it can be told: a sender's own words may stand in it, of any signs and any length."""
    told = text if len(text) <= longest else text[: longest - 3] + "..."
    return told.encode(errors="replace").decode()


def read_json(body: bytes, kind: type[S]) -> S:
    """Return the Struct that a body holds.

    Raises:
        RequestError: 400 where it is not JSON, 422 where a field is missing or has the wrong type; the field is named.
    """
    decoder = _decoders.get(kind)
    if decoder is None:
        decoder = _decoders[kind] = msgspec.json.Decoder(kind)
    try:
        value: S = decoder.decode(body)
    except msgspec.ValidationError as error:
        _refuse_value(str(error))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        _refuse_text(body, str(error))
    return value


def _refuse_value(text: str) -> NoReturn:
    message, _, path = text.partition(" - at `")
    field = path.rstrip("`").removeprefix("$").removeprefix(".") or "body"
    missing = re.search(r"missing required field `(\w+)`", message)
    if missing:
        field = missing[1] if field == "body" else f"{field}.{missing[1]}"
        refuse(field, "is missing", allowed="required")
    expected = re.match(r"Expected `([^`]+)`, got `([^`]+)`", message)
    if expected:
        refuse(field, "has the wrong type", found=expected[2], allowed=expected[1])
    refuse(field, message)


def _refuse_text(body: bytes, reason: str) -> NoReturn:
    """Name the field where the text is JSON but for NaN or infinity, which many writers let through."""
    try:
        field = _not_finite(json.loads(body), "")
    except (ValueError, RecursionError):
        field = None
    if field is None:
        refuse("body", "is not JSON", found=reason, allowed="JSON, UTF-8", status=400)
    refuse(field or "body", "is not a finite number", found="NaN or infinity", allowed="finite numbers", status=422)


def _not_finite(value: Any, path: str) -> str | None:
    if isinstance(value, float):
        return None if math.isfinite(value) else path
    parts: list[tuple[str, Any]] = []
    if isinstance(value, dict):
        parts = [(f"{path}.{key}" if path else str(key), part) for key, part in value.items()]
    elif isinstance(value, list):
        parts = [(f"{path}[{index}]", part) for index, part in enumerate(value)]
    for name, part in parts:
        found = _not_finite(part, name)
        if found is not None:
            return found
    return None
