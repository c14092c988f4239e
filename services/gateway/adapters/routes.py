"""Where other programs post: Sensor Logger's pushes, FIND3's ``/data`` and ``/passive``.

A token may stand in the path, for programs that can send no header: such paths are never logged.
"""

from __future__ import annotations

import time
from collections import Counter as Tally
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
from fastapi import APIRouter, Request, Response
from prometheus_client import Counter

from services.gateway.adapters.adapter import PhoneAdapter
from services.gateway.adapters.find3 import Find3, Find3Post, read_passive
from services.gateway.adapters.replies import AdapterReply, Find3Error, Find3Reply
from services.gateway.adapters.sensor_logger import SensorLogger, SensorLoggerPush
from services.gateway.devices.enrolment import same_key
from services.gateway.devices.tokens import POST
from services.gateway.errors import RequestError, refuse
from services.gateway.web.gateway import Gateway
from services.gateway.web.intake import Intake
from services.gateway.web.openapi import answers, takes
from services.gateway.web.replies import REFUSED, respond
from services.gateway.web.who_asks import WhoAsks

__all__ = ["adapter_routes"]

PAYLOADS = Counter("atrium_gateway_adapter_payloads_total", "Payloads of other programs", ["adapter", "result"])
LEFT_OUT = Counter("atrium_gateway_adapter_ignored_total", "What was not used of them", ["adapter", "reason"])
PATH = "/v1/adapters"
SENSOR_LOGGERS: dict[str, SensorLogger] = {"android": SensorLogger(), "ios": SensorLogger("ios")}
FIND3 = Find3()


def adapter_routes(gateway: Gateway, who_asks: WhoAsks, intake: Intake) -> APIRouter:
    """Return the routes. Tokens need the scope ``post``."""
    router = APIRouter(prefix=PATH, tags=["other programs"])
    errors = (400, 401, 403, 408, 413, 415, 422, 429, 503)
    pushed: dict[str, Any] = {
        "responses": answers(200, AdapterReply, *errors),
        "openapi_extra": takes(SensorLoggerPush),
    }
    pushed["responses"][202] = pushed["responses"][200]
    posted: dict[str, Any] = {
        "responses": answers(200, Find3Reply, *errors, error=Find3Error),
        "openapi_extra": takes(Find3Post),
    }
    settings = gateway.settings
    limits = settings.limits()

    async def take(adapter: PhoneAdapter, request: Request, token: str) -> AdapterReply:
        received = time.time()
        grant = await who_asks.owner(token, POST)
        intake.admit(grant.device.id)
        payload = await gateway.bodies.read(grant.device.id, request.scope, request.receive, settings.batch_bytes)
        push = await gateway.work(adapter.decode, payload, limits)
        ignored = +Tally(push.ignored)
        for reason, count in ignored.items():
            LEFT_OUT.labels(adapter.name, reason).inc(count)
        if push.batch is None:
            return AdapterReply(duplicate=False, received=received, ignored=ignored)
        if not who_asks.still_holds(token, grant):  # the consent may have been withdrawn while the body came
            grant = await who_asks.owner(token, POST)
        seq = gateway.numbering.number(grant.device.id, (adapter.name, *push.key))
        reply = await intake.take(grant.device, msgspec.structs.replace(push.batch, seq=seq), received, adapter.name)
        return AdapterReply(
            duplicate=reply.duplicate,
            received=received,
            late=reply.late,
            accepted=reply.accepted,
            ignored=ignored + Tally(reply.ignored),
        )

    async def sensor_logger(request: Request, token: str) -> Response:
        frame = request.query_params.get("frame", "android")
        with _counted(SensorLogger.name):
            if frame not in SENSOR_LOGGERS:
                refuse("frame", "is no frame", frame, "android, ios")
            reply = await take(SENSOR_LOGGERS[frame], request, token)
        return respond(reply, 202 if reply.late else 200)

    @router.post("/sensor-logger", **pushed)
    async def sensor_logger_with_header(request: Request) -> Response:
        """Take a push of the Sensor Logger app; token in the header ``Authorization``, with or without ``Bearer``."""
        return await sensor_logger(request, _token_of(request))

    @router.post("/sensor-logger/{token}", **pushed)
    async def sensor_logger_with_path(token: str, request: Request) -> Response:
        """Take a push of the Sensor Logger app; token in the path."""
        return await sensor_logger(request, token)

    @router.post("/find3/{token}/data", **posted)
    async def find3_data(token: str, request: Request) -> Response:
        """Take what a phone heard, in FIND3's form. Server address of its app: all before ``/data``."""
        try:
            with _counted(FIND3.name):
                reply = await take(FIND3, request, token)
        except RequestError as error:
            return _find_error(error)
        return respond(Find3Reply(success=True, message="inserted data" if reply.accepted.scans else "nothing of use"))

    @router.post("/find3/{key}/passive", **posted)
    async def find3_passive(key: str, request: Request) -> Response:
        """Take what a fixed receiver heard, in FIND3's form; ``key`` is the receivers' key."""
        try:
            with _counted("find3 passive"):
                message = await _take_passive(gateway, key, request)
        except RequestError as error:
            return _find_error(error)
        return respond(Find3Reply(success=True, message=message))

    return router


async def _take_passive(gateway: Gateway, key: str, request: Request) -> str:
    settings, receivers = gateway.settings, gateway.receivers
    wanted = settings.receiver_key
    if wanted is None or not same_key(key, wanted.get_secret_value()):
        refuse("path", "holds no valid key of receivers", status=403)
    received = time.time()
    sender = f"receiver {request.client.host if request.client else ''}"
    payload = await gateway.bodies.read(sender, request.scope, request.receive, settings.batch_bytes)
    name, report = await gateway.work(
        read_passive, payload, settings.receiver_readings, settings.limits().address_length
    )
    if not receivers.knows(name):
        refuse(
            "d", "is no receiver of this site", name, "a name that stands in the site file, access_points[].receivers"
        )
    used = (await gateway.work(receivers.take, report.heard, received)).get("used", 0)
    return f"inserted {used} fingerprints"


@contextmanager
def _counted(adapter: str) -> Iterator[None]:
    """Count how a payload ends: accepted, waiting (to be sent again) or refused."""
    try:
        yield
    except RequestError as error:
        PAYLOADS.labels(adapter, "waiting" if error.status in (429, 503) else "refused").inc()
        raise
    PAYLOADS.labels(adapter, "accepted").inc()


def _token_of(request: Request) -> str:
    kind, _, token = request.headers.get("authorization", "").strip().partition(" ")
    return token.strip() if kind.lower() == "bearer" else kind


def _find_error(error: RequestError) -> Response:
    REFUSED.labels(str(error.status)).inc()
    said = error.reply
    reply = Find3Error(status=said.status, detail=said.detail, retry_after=said.retry_after, message=str(error))
    return respond(reply, error.status, error.headers)
