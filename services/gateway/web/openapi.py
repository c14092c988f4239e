"""The OpenAPI page: schemas generated from the protocol's Structs, with worked examples."""

from __future__ import annotations

from typing import Any

import msgspec
from fastapi import FastAPI

from services.gateway import protocol

__all__ = ["answers", "complete", "takes"]

_STRUCTS = (
    protocol.Enrolment,
    protocol.Enrolled,
    protocol.Batch,
    protocol.BatchReply,
    protocol.Position,
    protocol.ErrorReply,
)
_EXAMPLES: dict[type[msgspec.Struct], dict[str, Any]] = {
    protocol.Enrolment: {
        "a phone in the hand": {
            "enrolment_key": "demo-enrolment-key",
            "consent": True,
            "name": "Museum guide",
            "platform": "android",
            "carrying": "hand",
        }
    },
    protocol.Batch: {
        "two samples and a scan": {
            "sent": 1767225601.0,
            "seq": 0,
            "imu": {
                "t": [1767225600.96, 1767225600.98],
                "ax": [0.1, 0.2],
                "ay": [0.3, 0.1],
                "az": [9.8, 9.9],
                "gx": [0, 0],
                "gy": [0, 0],
                "gz": [0.01, 0.01],
                "mx": [0, 0],
                "my": [20, 20],
                "mz": [-43, -43],
            },
            "radio": [
                {
                    "t": 1767225600.5,
                    "kind": "wifi",
                    "address": ["02:a7:00:00:00:01", "02:a7:00:00:00:02"],
                    "rssi": [-52, -61],
                }
            ],
        },
        "a beacon scan alone, with the last reply echoed": {
            "sent": 1767225602.0,
            "seq": 1,
            "radio": [{"t": 1767225601.7, "kind": "ble", "address": ["02:a7:00:00:00:03"], "rssi": [-70]}],
            "echo": {"replied": 1767225601.031, "arrived": 1767225601.06},
        },
    },
}
_WHY = {
    400: "the body is not JSON",
    401: "the token is missing, wrong or withdrawn",
    403: "the key is wrong, or the token is another device's",
    404: "no such device, or it has not been located yet",
    413: "the body is too large",
    415: "the body is compressed",
    422: "a field is wrong; it is named",
    429: "too many attempts; see Retry-After",
    503: "try again; see Retry-After",
}


def takes(kind: type[msgspec.Struct]) -> dict[str, Any]:
    """Return the ``openapi_extra`` of a route whose body is ``kind``."""
    content: dict[str, Any] = {"schema": _reference(kind)}
    if kind in _EXAMPLES:
        content["examples"] = {name: {"summary": name, "value": example} for name, example in _EXAMPLES[kind].items()}
    return {"requestBody": {"required": True, "content": {"application/json": content}}}


def answers(status: int, kind: type[msgspec.Struct] | None, *errors: int) -> dict[int | str, dict[str, Any]]:
    """Return the ``responses`` of a route: ``kind`` with ``status``, and the errors it may give."""
    body = {} if kind is None else {"content": {"application/json": {"schema": _reference(kind)}}}
    described: dict[int | str, dict[str, Any]] = {status: {"description": "done", **body}}
    for error in errors:
        schema = _reference(protocol.ErrorReply)
        described[error] = {"description": _WHY[error], "content": {"application/json": {"schema": schema}}}
    return described


def complete(app: FastAPI) -> None:
    """Add the Structs' schemas to the document that FastAPI makes of the routes."""
    plain = app.openapi

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            made = plain()
            _, components = msgspec.json.schema_components(_STRUCTS, ref_template="#/components/schemas/{name}")
            made.setdefault("components", {}).setdefault("schemas", {}).update(components)
            app.openapi_schema = made
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]


def _reference(kind: type[msgspec.Struct]) -> dict[str, str]:
    return {"$ref": f"#/components/schemas/{kind.__name__}"}
