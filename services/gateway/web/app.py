"""The gateway's HTTP application: what a phone may ask, and who may ask it."""

from __future__ import annotations

import asyncio
import threading
import time
from base64 import b64decode
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import NoReturn, TypeVar

import msgspec
import structlog
from fastapi import FastAPI, Request, Response
from fastapi_offline import FastAPIOffline
from prometheus_client import Counter
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException

from services.gateway.devices.enrolment import AttemptLimiter, key_of, qr_svg, qr_text, same_key
from services.gateway.devices.known_tokens import KnownTokens
from services.gateway.devices.own_position import OwnPositions
from services.gateway.devices.storage import DeviceStore, Registered
from services.gateway.errors import RequestError, read_json, refuse
from services.gateway.phones.phone_book import PhoneBook, busy
from services.gateway.protocol import (
    Batch,
    BatchReply,
    Enrolled,
    Enrolment,
    ErrorReply,
    FieldError,
    Position,
)
from services.gateway.settings import GatewaySettings
from services.gateway.web.openapi import answers, complete, takes

__all__ = ["Gateway", "create_app"]

REFUSED = Counter("atrium_gateway_refused_total", "Requests refused", ["status"])
ENROLLED = Counter("atrium_gateway_enrolled_total", "Devices enrolled")
WITHDRAWN = Counter("atrium_gateway_withdrawn_total", "Consents withdrawn")
ENROLMENT_BYTES = 16_384
DISCARD = 1 << 25
"""Bytes of an oversized body read and thrown away, so that its sender sees the answer, not a broken pipe."""
WRONG_KEY_COSTS = 10.0
WAITING_BATCHES = 500
"""Batches in work at once; more are answered 503 rather than kept waiting."""

T = TypeVar("T")
log = structlog.get_logger(__name__)


@dataclass(slots=True)
class Gateway:
    """What the application works with."""

    settings: GatewaySettings
    site: str
    store: DeviceStore
    phones: PhoneBook
    positions: OwnPositions
    started: Callable[[], None]


def create_app(gateway: Gateway) -> FastAPI:
    """Return the application."""
    settings = gateway.settings
    limiter = AttemptLimiter(settings.enrolments_per_minute, settings.enrolment_burst)
    workers = ThreadPoolExecutor(2, "phones")  # dead reckoning and the bus never hold the event loop
    places = threading.BoundedSemaphore(WAITING_BATCHES)
    known = KnownTokens(settings.token_recheck)

    @asynccontextmanager
    async def life(_app: FastAPI) -> AsyncIterator[None]:
        gateway.started()
        yield
        workers.shutdown(wait=False, cancel_futures=True)

    app = FastAPIOffline(
        redoc_url=None,
        title="Atrium gateway",
        summary="Where phones post what they measure and read where they are.",
        version="1",
        lifespan=life,
    )
    complete(app)
    _report_errors(app)

    async def work(task: Callable[..., T], *arguments: object) -> T:
        return await asyncio.get_running_loop().run_in_executor(workers, task, *arguments)

    async def whose(request: Request, device: str) -> Registered:
        """Return the device that the token belongs to, if it is the one in the path. The token is looked at first."""
        token = _bearer(request)
        found = known.get(token)
        if found is None:
            found = await work(gateway.store.by_token, token)
            # A query under way while the consent was withdrawn must not bring a dead token back.
            if found is None or gateway.phones.has_forgotten(found.id):
                _refuse_token()
            known.remember(token, found)
        if found.id != device:
            if await work(gateway.store.exists, device):
                refuse("device", "the token is another device's", status=403)
            refuse("device", "is not enrolled", found=device, status=404)
        return found

    def ration(address: str) -> None:
        wait = limiter.wait(address)
        if wait > 0.0:
            problem = FieldError(field="", problem="too many attempts from this address")
            raise RequestError(429, problem, headers={"Retry-After": str(int(wait) + 1)})

    @app.post(
        "/v1/devices",
        status_code=201,
        openapi_extra=takes(Enrolment),
        responses=answers(201, Enrolled, 400, 403, 413, 415, 422, 429, 503),
    )
    async def enrol(request: Request) -> Response:
        """Enrol a phone whose carrier agrees to be located."""
        address = request.client.host if request.client else ""
        ration(address)
        content = await _body(request, ENROLMENT_BYTES)
        ration(address)  # again: bodies held back and sent together must not make a burst of guesses
        body = read_json(content, Enrolment)
        if not same_key(key_of(body.enrolment_key), settings.enrolment_key.get_secret_value()):
            limiter.spend(address, WRONG_KEY_COSTS)
            refuse("enrolment_key", "is wrong", allowed="this site's key, or the text of its QR code", status=403)
        limiter.spend(address)
        if not body.consent:
            refuse("consent", "is not given", found="false", allowed="true, once the person has agreed")
        for name in ("name", "platform", "consent_version"):
            text = getattr(body, name)
            if len(text) > 64 or not (text.isprintable() or not text):
                refuse(name, "is no short text", found=text, allowed="at most 64 printable characters")
        now = time.time()
        device, token = await work(
            gateway.store.enrol, now, body.consent_version, body.name, body.platform, body.carrying
        )
        ENROLLED.inc()
        log.info("device enrolled", device=device.id, platform=body.platform, carrying=body.carrying)
        path = f"/v1/devices/{device.id}"
        enrolled = Enrolled(
            device=device.id,
            token=token,
            site=gateway.site,
            consent_version=body.consent_version,
            time=now,
            batches=f"{path}/batches",
            position=f"{path}/position",
        )
        return _json(enrolled, 201)

    @app.get(
        "/v1/enrolment.svg",
        responses={200: {"description": "a QR code", "content": {"image/svg+xml": {}}}, **answers(401, ErrorReply)},
    )
    async def enrolment_code(request: Request) -> Response:
        """Show staff the QR code from which apps enrol. Key: the staff or enrolment key, as bearer or as password."""
        keys = [key for key in (settings.staff_key, settings.enrolment_key) if key is not None]
        given = _staff_key(request)
        address = request.client.host if request.client else ""
        if limiter.wait(address) > 0.0 or not any([same_key(given, key.get_secret_value()) for key in keys]):  # noqa: C419
            if given:
                limiter.spend(address, WRONG_KEY_COSTS)
            problem = FieldError(field="Authorization", problem="needs the staff key or the enrolment key")
            raise RequestError(401, problem, headers={"WWW-Authenticate": 'Basic realm="Atrium staff"'})
        url = settings.gateway_public_url or str(request.base_url).rstrip("/")
        picture = qr_svg(qr_text(url, settings.enrolment_key.get_secret_value()))
        return Response(picture, media_type="image/svg+xml", headers={"Cache-Control": "no-store"})

    @app.post(
        "/v1/devices/{device}/batches",
        openapi_extra=takes(Batch),
        responses=answers(200, BatchReply, 400, 401, 403, 404, 413, 415, 422, 503),
    )
    async def post_batch(device: str, request: Request) -> Response:
        """Take what a phone measured. The reply is sent once all of it is on the bus."""
        received = time.time()
        owner = await whose(request, device)
        body = await _body(request, settings.batch_bytes)
        await whose(request, device)  # again: the consent may have been withdrawn while the body came
        if not places.acquire(blocking=False):
            raise busy("more batches wait than can be taken")
        try:
            return _json(await work(gateway.phones.post, owner, body, received))
        finally:
            places.release()

    @app.get(
        "/v1/devices/{device}/position",
        responses=answers(200, Position, 401, 403, 404),
    )
    async def own_position(device: str, request: Request) -> Response:
        """Tell a phone where it is itself."""
        await whose(request, device)
        position = gateway.positions.of(device, time.time())
        if position is None:
            refuse("device", "not located yet: no camera track carries this device", status=404)
        return _json(position)

    @app.delete("/v1/devices/{device}", status_code=204, responses=answers(204, None, 401, 403, 404, 503))
    async def withdraw(device: str, request: Request) -> Response:
        """Take the consent back: the token dies at once and the device is forgotten."""
        await whose(request, device)
        await work(gateway.store.withdraw, device, time.time())
        await work(gateway.phones.forget, device)
        known.forget(_bearer(request))  # after forgetting: a query that ended before that has been cached
        gateway.positions.forget(device)
        WITHDRAWN.inc()
        log.info("consent withdrawn", device=device)
        return Response(status_code=204)

    return app


_encoder = msgspec.json.Encoder()


def _json(value: msgspec.Struct, status: int = 200, headers: dict[str, str] | None = None) -> Response:
    return Response(_encoder.encode(value), status, headers, "application/json")


def _bearer(request: Request) -> str:
    kind, _, token = request.headers.get("authorization", "").partition(" ")
    if kind.lower() != "bearer" or not token:
        _refuse_token()
    return token.strip()


def _refuse_token() -> NoReturn:
    problem = FieldError(field="Authorization", problem="no valid token", allowed="Bearer TOKEN, from enrolment")
    raise RequestError(401, problem, headers={"WWW-Authenticate": "Bearer"})


def _staff_key(request: Request) -> str:
    kind, _, given = request.headers.get("authorization", "").partition(" ")
    if kind.lower() == "bearer":
        return given.strip()
    if kind.lower() == "basic":
        try:
            return b64decode(given, validate=True).decode().partition(":")[2]
        except ValueError:
            return ""
    return ""


async def _body(request: Request, limit: int) -> bytes:
    """Return the body; one that is too large is never held, however it is sent."""
    if request.headers.get("content-encoding", "identity") != "identity":
        refuse("Content-Encoding", "is not taken", request.headers["content-encoding"], "identity", 415)
    declared = request.headers.get("content-length", "")
    too_large = declared.isdigit() and int(declared) > limit
    body = bytearray()
    size = 0
    async for chunk in request.stream():
        size += len(chunk)
        too_large = too_large or size > limit
        if too_large:
            body.clear()
            if size > DISCARD or (declared.isdigit() and int(declared) > DISCARD):
                break
        else:
            body += chunk
    if too_large:
        found = f"{declared or size} bytes" + ("" if declared else " and more")
        problem = FieldError(field="body", problem="is too large", found=found, allowed=f"at most {limit} bytes")
        raise RequestError(413, problem, headers={"Connection": "close"})
    return bytes(body)


def _report_errors(app: FastAPI) -> None:
    """Give every error the one form of ``ErrorReply``."""

    def report(error: RequestError) -> Response:
        REFUSED.labels(str(error.status)).inc()
        return _json(error.reply, error.status, error.headers)

    @app.exception_handler(RequestError)
    async def refused(_request: Request, error: RequestError) -> Response:
        return report(error)

    @app.exception_handler(HTTPException)
    async def other(request: Request, error: HTTPException) -> Response:
        problem = FieldError(field="path", problem=str(error.detail), found=f"{request.method} {request.url.path}")
        return report(RequestError(error.status_code, problem, headers=dict(error.headers or {})))

    @app.exception_handler(SQLAlchemyError)
    async def database(_request: Request, error: SQLAlchemyError) -> Response:
        log.warning("database failed", error=str(error).splitlines()[0])
        return report(busy("the database is away"))

    @app.exception_handler(Exception)
    async def bug(_request: Request, _error: Exception) -> Response:
        return report(RequestError(500, FieldError(field="", problem="the gateway failed; it has been logged")))
