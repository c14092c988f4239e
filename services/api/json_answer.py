"""Answers in JSON, made from Structs."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import msgspec
from starlette.responses import Response

__all__ = ["json_answer", "unkept_answer"]

_NONE: Mapping[str, str] = MappingProxyType({})


def json_answer(body: msgspec.Struct, status: int = 200, headers: Mapping[str, str] = _NONE) -> Response:
    """Return an answer with this body."""
    return Response(msgspec.json.encode(body), status, headers, media_type="application/json")


def unkept_answer(body: msgspec.Struct, status: int = 200, headers: Mapping[str, str] = _NONE) -> Response:
    """Return an answer that no browser and no proxy may keep."""
    return json_answer(body, status, {"Cache-Control": "no-store", **headers})
