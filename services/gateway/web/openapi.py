"""The OpenAPI page: schemas generated from the protocol's Structs, with worked examples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec
from fastapi import FastAPI

from services.gateway import protocol
from services.gateway.web.examples import EXAMPLES

__all__ = ["answers", "complete", "takes"]

_WHY = {
    400: "the body is not JSON, or not compressed as its header says",
    401: "the token is missing, wrong, expired or revoked",
    403: "the key is wrong, or the token is another device's or may not do this",
    404: "no such device, or it has not been located yet",
    408: "the body came too slowly",
    413: "the body is too large",
    415: "the body's compression is not known",
    422: "a field is wrong; it is named",
    429: "too many; see Retry-After",
    503: "try again; see Retry-After",
}
_RETRY_AFTER = {"Retry-After": {"description": "seconds to wait", "schema": {"type": "integer"}}}
_DESCRIPTION = """
Enrol once, then post what the phone measured about once a second. `/v1/devices/{device}/stream` takes the same batches
over a WebSocket: each frame is one `Batch`, answered by one `BatchReply` or `ErrorReply`. JSON Schemas of all bodies
are at `/v1/schema/{name}.json`.
"""


def takes(kind: type[msgspec.Struct]) -> dict[str, Any]:
    """Return the ``openapi_extra`` of a route whose body is ``kind``."""
    return {"requestBody": {"required": True, "content": _content(kind)}}


def answers(
    status: int, kind: type[msgspec.Struct] | None, *errors: int, error: type[msgspec.Struct] = protocol.ErrorReply
) -> dict[int | str, dict[str, Any]]:
    """Return the ``responses`` of a route: ``kind`` with ``status``, and the errors it may give, each an ``error``."""
    body = {} if kind is None else {"content": _content(kind)}
    described: dict[int | str, dict[str, Any]] = {status: {"description": "done", **body}}
    for code in errors:
        reference = {"application/json": {"schema": _reference(error)}}
        described[code] = {"description": _WHY[code], "content": reference}
        if code in (429, 503):
            described[code]["headers"] = _RETRY_AFTER
    return described


def complete(app: FastAPI, bodies: Sequence[type[msgspec.Struct]]) -> None:
    """Add to the document that FastAPI makes: the schemas, the tokens, and the one route that is not FastAPI's."""
    plain = app.openapi
    app.description = _DESCRIPTION

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            made = plain()
            made["paths"]["/v1/devices/{device}/batches"] = {"post": _batches()}
            for path, operations in made["paths"].items():
                if path.startswith("/v1/devices/"):
                    for operation in operations.values():
                        operation["security"] = [{"token": []}]
            _, schemas = msgspec.json.schema_components(bodies, ref_template="#/components/schemas/{name}")
            components = made.setdefault("components", {})
            components.setdefault("schemas", {}).update(schemas)
            components["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer", "bearerFormat": "JWT"}}
            app.openapi_schema = made
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]


def _batches() -> dict[str, Any]:
    described = answers(200, protocol.BatchReply, 400, 401, 403, 404, 408, 413, 415, 422, 429, 503)
    late = {"description": "done, too late for the live position", "content": _content(protocol.BatchReply)}
    return {
        "summary": "Post Batch",
        "description": "Take what a phone measured; gzip and deflate are welcome. The reply is sent once all of it is "
        "on the bus. Scope: `post`.",
        "operationId": "post_batch",
        "parameters": [{"name": "device", "in": "path", "required": True, "schema": {"type": "string"}}],
        **takes(protocol.Batch),
        "responses": {str(status): value for status, value in (described | {202: late}).items()},
    }


def _content(kind: type[msgspec.Struct]) -> dict[str, Any]:
    content: dict[str, Any] = {"schema": _reference(kind)}
    if kind in EXAMPLES:
        content["examples"] = {name: {"summary": name, "value": example} for name, example in EXAMPLES[kind].items()}
    return {"application/json": content}


def _reference(kind: type[msgspec.Struct]) -> dict[str, str]:
    return {"$ref": f"#/components/schemas/{kind.__name__}"}
