"""The OpenAPI document: schemas and examples come from the very Structs that make the replies."""

from __future__ import annotations

from typing import Any

import msgspec
from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.routing import APIRoute

from services.api.alerts.alert_replies import Acknowledged, Note
from services.api.alerts.webhook_replies import WebhookDefinition, WebhookMessage
from services.api.examples import EXAMPLES
from services.api.learning_replies import RollBack
from services.api.problems import MEDIA_TYPE, Problem
from services.api.replies import CameraReport, TrackColumns
from shared.messages import Alert, Occupancy, Revision

__all__ = ["GONE", "UNCHANGED", "accepted", "created", "describe", "documented", "drawn", "error", "errors", "named"]

_REFERENCE = "#/components/schemas/{name}"

_TOLD = (Acknowledged, Alert, CameraReport, Occupancy, Revision, TrackColumns, WebhookMessage)
"""What streams and webhooks tell."""

DESCRIPTION = """\
Who is where, in metres, now, what zones tell of it, what the system learns, and what staff draw and decide. Every path
below `/v1` needs an API key or the token of a sign-in: `Authorization: Bearer KEY` or `X-API-Key: KEY`. Times are
seconds since the epoch (UTC), lengths metres, covariances `[xx, xy, yy]` in m². Errors are problem details (RFC 9457)
that name field, found and allowed."""


def documented(body: type[msgspec.Struct], *statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the ``responses`` of a route that answers ``body`` or an error of one of these ``statuses``."""
    content = {"schema": {"$ref": _REFERENCE.format(name=body.__name__)}, "example": EXAMPLES[body]}
    answers: dict[int | str, dict[str, Any]] = {
        200: {"description": (body.__doc__ or "").strip(), "content": {"application/json": content}}
    }
    return answers | errors(*statuses)


def drawn(answers: dict[int | str, dict[str, Any]], example: dict[str, Any]) -> dict[int | str, dict[str, Any]]:
    """Return the ``responses`` of a route that answers in GeoJSON, too, to who accepts that."""
    answers[200]["content"]["application/geo+json"] = {"schema": {"type": "object"}, "example": example}
    return answers


def errors(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the error answers of a route that needs a key and may answer these ``statuses`` besides."""
    too_slow = {408} if 413 in statuses else set[int]()
    return {status: error(status) for status in sorted({401, 403, 422, 429, *too_slow, *statuses})}


GONE: dict[int | str, dict[str, Any]] = {204: {"description": "It is gone."}}
"""The answer of a route that takes something out."""


def created(body: type[msgspec.Struct], *statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the ``responses`` of a route that makes a thing and answers 201 and ``body``, or one of these errors."""
    answers = documented(body, *statuses)
    answers[201] = answers.pop(200)
    return answers


def accepted(body: type[msgspec.Struct], *statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the ``responses`` of a route that begins a thing and answers 202 and ``body``, or one of these errors."""
    answers = documented(body, *statuses)
    answers[202] = answers.pop(200)
    return answers


UNCHANGED: dict[int | str, dict[str, Any]] = {
    304: {"description": "If-None-Match names the ETag that the answer would have: nothing is new"}
}
"""The answer of a hot read to who has it already."""


def error(status: int) -> dict[str, Any]:
    """Return the description of one error answer."""
    what = {
        401: "no valid key",
        403: "the key lacks the scope",
        404: "an id that names nothing, or nothing is known of it yet",
        409: "not possible now; detail says why",
        410: "the event is no longer held; begin anew",
        412: "somebody else changed it since it was read; the ETag says to what",
        408: "the body does not come",
        413: "the body is too large",
        422: "a value out of range, or a parameter that means nothing here",
        429: "too many requests; try again after Retry-After seconds",
        503: "not now: too many streams, or what answers it is away; try again after Retry-After seconds",
    }[status]
    return {"description": what, "content": {MEDIA_TYPE: {"schema": {"$ref": _REFERENCE.format(name="Problem")}}}}


def named(route: APIRoute) -> str:
    """Return the id of an operation, from which programs are made: ``positions_tracks``, ``zones_add``."""
    return f"{route.tags[0]}_{route.name}".replace("-", "_") if route.tags else route.name


_PATH = {
    "alert": "id of an alert",
    "area": "id of an area",
    "camera": "id of a camera",
    "device": "id of a device, as positions tell it",
    "item": "its id",
    "key": "id of a key",
    "kind": "visits, occlusion, radio, shadowing or magnetic",
    "name": "of one of the staff",
    "webhook": "id of a webhook",
}
_SECONDS = {"description": "seconds to wait", "schema": {"type": "integer"}}
_TEXT = {"type": "string"}
_ETAG = {"description": "which state this is: for If-None-Match, or If-Match of a change", "schema": _TEXT}
_HEADERS: dict[str, dict[str, Any]] = {
    "201": {"Location": {"description": "its path", "schema": _TEXT}},
    "401": {"WWW-Authenticate": {"description": "Bearer", "schema": _TEXT}},
    "412": {"ETag": _ETAG},
    "429": {"Retry-After": _SECONDS},
    "503": {"Retry-After": _SECONDS | {"description": "seconds to wait, where that is known"}},
}


def _complete(path: str, operation: dict[str, Any]) -> None:
    """Write down what all operations have in common."""
    answers, parameters = operation["responses"], operation.setdefault("parameters", [])
    if "422" in answers:
        answers["422"] = error(422)
    for status, headers in _HEADERS.items():
        if status in answers:
            answers[status].setdefault("headers", {}).update(headers)
    if "304" in answers or path.startswith(("/v1/zones", "/v1/exhibits")):
        for status in {"200", "201", "304"} & set(answers):
            answers[status].setdefault("headers", {})["ETag"] = _ETAG
    if "304" in answers:
        held = "ETag of the answer one has: 304 where it is still that; without other parameters"
        parameters.append({"name": "If-None-Match", "in": "header", "description": held, "schema": _TEXT})
    for parameter in parameters:
        if parameter["in"] == "path":
            parameter.setdefault("description", _PATH[parameter["name"]])


def describe(app: FastAPI) -> None:
    """Give ``app`` its OpenAPI document, built at the first request for it."""

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            schema = get_openapi(title=app.title, version=app.version, description=DESCRIPTION, routes=app.routes)
            structs = [*EXAMPLES, *_TOLD, Problem, RollBack, Note, WebhookDefinition]
            _, components = msgspec.json.schema_components(structs, ref_template=_REFERENCE)
            parts = schema.setdefault("components", {})
            parts["schemas"] = components
            parts["securitySchemes"] = {
                "bearer": {"type": "http", "scheme": "bearer"},
                "header": {"type": "apiKey", "in": "header", "name": "X-API-Key"},
            }
            schema["security"] = [{"bearer": []}, {"header": []}]
            for path, operations in schema["paths"].items():
                for operation in operations.values():
                    _complete(path, operation)
            app.openapi_schema = schema
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]
