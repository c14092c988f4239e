"""The JSON Schema of every body, one file each, for those who generate or check bodies with it."""

from __future__ import annotations

import json
import re
from typing import Any

import msgspec
from fastapi import APIRouter, Response

from services.gateway import protocol
from services.gateway.adapters.find3 import Find3Post
from services.gateway.adapters.replies import AdapterReply, Find3Error, Find3Reply
from services.gateway.adapters.sensor_logger import SensorLoggerPush
from services.gateway.errors import refuse
from services.gateway.protocol import ErrorReply
from services.gateway.web.openapi import answers

__all__ = ["BODIES", "schema_routes"]

BODIES: tuple[type[msgspec.Struct], ...] = (
    protocol.Consent,
    protocol.Enrolment,
    protocol.Enrolled,
    protocol.Change,
    protocol.OwnDevice,
    protocol.OwnRecord,
    protocol.OwnExport,
    protocol.TokenRequest,
    protocol.NewToken,
    protocol.Tokens,
    protocol.Batch,
    protocol.BatchReply,
    protocol.Position,
    protocol.OwnAlerts,
    protocol.TrialWalks,
    protocol.TrialWalksReply,
    protocol.ErrorReply,
    SensorLoggerPush,
    AdapterReply,
    Find3Post,
    Find3Reply,
    Find3Error,
)
DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schema_routes() -> APIRouter:
    """Return the route that serves the schemas."""
    router = APIRouter()
    files = {_file_name(body): _document(body) for body in BODIES}

    @router.get(
        "/v1/schema/{name}.json",
        responses={
            200: {"description": "a JSON Schema", "content": {"application/schema+json": {}}},
            **answers(404, ErrorReply),
        },
    )
    async def schema(name: str) -> Response:
        """Return the JSON Schema of one body: `batch`, `enrolment`, `position` and so on."""
        if name not in files:
            refuse("name", "there is no such schema", name, ", ".join(files), 404)
        return Response(files[name], media_type="application/schema+json")

    return router


def _file_name(body: type[msgspec.Struct]) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "-", body.__name__).lower()


def _document(body: type[msgspec.Struct]) -> bytes:
    schema: dict[str, Any] = {"$schema": DIALECT, **msgspec.json.schema(body)}
    return json.dumps(schema, indent=1, ensure_ascii=False).encode()
