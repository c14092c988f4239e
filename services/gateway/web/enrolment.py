"""Enrolment: the consent text, a new device, the QR code from which apps enrol."""

from __future__ import annotations

import math
import time
from base64 import b64decode

import structlog
from fastapi import APIRouter, Request, Response
from prometheus_client import Counter

from services.gateway.devices.enrolment import key_of, qr_svg, qr_text, same_key
from services.gateway.devices.storage import Newcomer, TransmitterTakenError
from services.gateway.devices.tokens import SCOPES, TokenSigner
from services.gateway.devices.transmitters import FORMS, can_be_enrolled
from services.gateway.errors import RequestError, read_json, refuse
from services.gateway.protocol import Consent, Enrolled, Enrolment, ErrorReply, FieldError
from services.gateway.web.gateway import Gateway
from services.gateway.web.openapi import answers, takes
from services.gateway.web.replies import respond
from shared.rate_limiter import RateLimiter

__all__ = ["enrolment_routes"]

ENROLLED = Counter("atrium_gateway_enrolled_total", "Devices enrolled")
ENROLMENT_BYTES = 16_384
WRONG_KEY_COSTS = 10.0
MOST_TRANSMITTERS = 8
LONGEST_TEXT = 64
DAY = 86_400.0

log = structlog.get_logger(__name__)


def enrolment_routes(gateway: Gateway, signer: TokenSigner) -> APIRouter:
    """Return the routes that need no token."""
    router = APIRouter()
    settings = gateway.settings
    limiter = RateLimiter(settings.enrolments_per_minute / 60.0, settings.enrolment_burst)

    def ration(address: str) -> None:
        wait = limiter.wait(address)
        if wait > 0.0:
            problem = FieldError(field="", problem="too many attempts from this address")
            raise RequestError(429, problem, headers={"Retry-After": str(math.ceil(wait))})

    @router.get("/v1/consent", responses=answers(200, Consent))
    async def consent() -> Response:
        """Tell what a visitor is asked to agree to."""
        return respond(Consent(version=gateway.consent.version, text=gateway.consent.text))

    @router.post(
        "/v1/devices",
        status_code=201,
        openapi_extra=takes(Enrolment),
        responses=answers(201, Enrolled, 400, 403, 408, 413, 415, 422, 429, 503),
    )
    async def enrol(request: Request) -> Response:
        """Enrol a phone whose carrier agrees to be located."""
        address = _address(request)
        ration(address)
        content = await gateway.bodies.read(address, request.scope, request.receive, ENROLMENT_BYTES)
        ration(address)  # again: bodies held back and sent together must not make a burst of guesses
        body = read_json(content, Enrolment)
        if not same_key(key_of(body.enrolment_key), settings.enrolment_key.get_secret_value()):
            limiter.spend(address, WRONG_KEY_COSTS)
            refuse("enrolment_key", "is wrong", allowed="this site's key, or the text of its QR code", status=403)
        if body.transmitters:
            wanted = settings.staff_key
            if wanted is None or not same_key(body.staff_key, wanted.get_secret_value()):
                limiter.spend(address, WRONG_KEY_COSTS)
                refuse(
                    "staff_key",
                    "is wrong",
                    allowed="this site's staff key: transmitters are claimed by staff",
                    status=403,
                )
        limiter.spend(address)
        _check(body, gateway.consent.version)
        now = time.time()
        newcomer = Newcomer(gateway.consent.version, body.name, body.platform, body.carrying, tuple(body.transmitters))
        expires = now + settings.token_days * DAY
        address_key = settings.address_key.get_secret_value()
        try:
            device, token = await gateway.work(gateway.store.enrol, now, newcomer, SCOPES, expires, address_key)
        except TransmitterTakenError as error:
            refuse(f"transmitters[{error.index}]", "is enrolled already", allowed="a transmitter of one's own")
        if body.transmitters:
            gateway.receivers.expect_news()
        ENROLLED.inc()
        log.info("device enrolled", device=device.id, platform=body.platform, carrying=body.carrying)
        path = f"/v1/devices/{device.id}"
        enrolled = Enrolled(
            device=device.id,
            token=signer.sign(device.id, token.id, token.scopes, token.expires),
            expires=token.expires,
            site=gateway.site,
            consent_version=newcomer.consent_version,
            time=now,
            batches=f"{path}/batches",
            stream=f"{path}/stream",
            position=f"{path}/position",
            alerts=f"{path}/alerts",
        )
        return respond(enrolled, 201)

    @router.get(
        "/v1/enrolment.svg",
        responses={200: {"description": "a QR code", "content": {"image/svg+xml": {}}}, **answers(401, ErrorReply)},
    )
    async def enrolment_code(request: Request) -> Response:
        """Show staff the QR code from which apps enrol. Key: the staff or enrolment key, as bearer or as password."""
        keys = [key for key in (settings.staff_key, settings.enrolment_key) if key is not None]
        given = _staff_key(request)
        address = _address(request)
        if limiter.wait(address) > 0.0 or not any([same_key(given, key.get_secret_value()) for key in keys]):  # noqa: C419
            if given:
                limiter.spend(address, WRONG_KEY_COSTS)
            problem = FieldError(field="Authorization", problem="needs the staff key or the enrolment key")
            raise RequestError(401, problem, headers={"WWW-Authenticate": 'Basic realm="Atrium staff"'})
        url = settings.gateway_public_url or str(request.base_url).rstrip("/")
        picture = qr_svg(qr_text(url, settings.enrolment_key.get_secret_value()))
        return Response(picture, media_type="image/svg+xml", headers={"Cache-Control": "no-store"})

    return router


def _check(body: Enrolment, version: str) -> None:
    if not body.consent:
        refuse("consent", "is not given", found="false", allowed="true, once the person has agreed")
    if body.consent_version not in ("", version):
        refuse("consent_version", "is not the text that is valid now", body.consent_version, version)
    for name in ("name", "platform"):
        _check_text(getattr(body, name), name, 0)
    if len(body.transmitters) > MOST_TRANSMITTERS:
        refuse("transmitters", "too many", len(body.transmitters), f"at most {MOST_TRANSMITTERS}")
    for index, transmitter in enumerate(body.transmitters):
        _check_text(transmitter, f"transmitters[{index}]", 1)
        if not can_be_enrolled(transmitter):
            refuse(f"transmitters[{index}]", "is no name of one transmitter alone", transmitter, FORMS)


def _check_text(text: str, field: str, shortest: int) -> None:
    if not shortest <= len(text) <= LONGEST_TEXT or not (text.isprintable() or not text):
        refuse(field, "is no short text", found=text, allowed=f"{shortest} to {LONGEST_TEXT} printable characters")


def _address(request: Request) -> str:
    return request.client.host if request.client else ""


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
