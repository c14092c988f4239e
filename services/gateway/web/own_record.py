"""What a visitor may see of themselves: all that is stored of their phone, at a glance or to be taken away."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator, Iterator

import structlog
from fastapi import APIRouter, Request, Response
from starlette.responses import StreamingResponse

from services.gateway.devices.own_past import AwayError, OwnPast
from services.gateway.devices.storage import Record
from services.gateway.devices.tokens import READ
from services.gateway.errors import RequestError, refuse
from services.gateway.phones.phone_book import busy
from services.gateway.protocol import FieldError, OwnConsent, OwnExport, OwnRecord, OwnSteps, OwnWay
from services.gateway.web.bodies import header
from services.gateway.web.gateway import Gateway
from services.gateway.web.openapi import answers
from services.gateway.web.replies import encode, respond
from services.gateway.web.who_asks import WhoAsks, bearer
from shared.rate_limiter import RateLimiter

__all__ = ["own_record_routes"]

AT_ONCE = 2
"""Phones that other services are asked about at once; more are told to come again."""
PER_SECOND, BURST = 1.0 / 10.0, 12
"""How often one phone may ask."""
EXPORT_COSTS = 3.0
"""Times what a glance does."""

log = structlog.get_logger(__name__)


def own_record_routes(gateway: Gateway, who_asks: WhoAsks) -> APIRouter:
    """Return the routes."""
    router = APIRouter()
    past = OwnPast(gateway.bus, gateway.keys, gateway.alerts.told)
    limiter = RateLimiter(PER_SECOND, BURST)
    places = asyncio.Semaphore(AT_ONCE)

    async def admit(request: Request, device: str, cost: float) -> None:
        await who_asks.grant(bearer(header(request.scope, b"authorization")), device, READ)
        wait = limiter.wait(device, cost)
        if wait > 0.0:
            problem = FieldError(field="", problem="this device asks too often")
            raise RequestError(429, problem, headers={"Retry-After": str(math.ceil(wait))})
        if places.locked():
            raise busy("others ask what is stored of them just now")
        limiter.spend(device, cost)

    async def record_of(device: str) -> OwnRecord:
        try:
            stored = await gateway.work(gateway.store.record, device, time.time())
        except KeyError:  # withdrawn a moment ago
            refuse("device", "is not enrolled", found=device, status=404)
        return await asyncio.to_thread(_record, gateway, past, device, stored)

    @router.get("/v1/devices/{device}", responses=answers(200, OwnRecord, 401, 403, 404, 429, 503))
    async def own_record(device: str, request: Request) -> Response:
        """Tell a visitor what is stored of their phone, and for how long. Scope: `read`."""
        await admit(request, device, 1.0)
        async with places:
            return respond(await record_of(device), headers={"Cache-Control": "no-store"})

    @router.get("/v1/devices/{device}/export", responses=answers(200, OwnExport, 401, 403, 404, 429, 503))
    async def export(device: str, request: Request) -> Response:
        """Give a visitor all that is stored of their phone, with where it was since it enrolled. Scope: `read`.

        A download that breaks off is not whole: history went away meanwhile.
        """
        await admit(request, device, EXPORT_COSTS)
        async with places:
            record = await record_of(device)
            ways = past.ways(device, record.enrolled, time.time())
            try:
                first = await asyncio.to_thread(next, ways, None)
            except AwayError as error:
                raise busy(str(error)) from error
        return StreamingResponse(
            _portions(record, first, ways, places),
            media_type="application/json",
            headers={
                "Cache-Control": "no-store",
                "Content-Disposition": f'attachment; filename="atrium-{device}.json"',
            },
        )

    return router


def _record(gateway: Gateway, past: OwnPast, device: str, stored: Record) -> OwnRecord:
    kept = past.kept()
    silent = [] if any(row.service == "history" for row in kept) else ["history"]
    learned = None
    try:
        learned = past.learned(device)
    except AwayError as error:
        log.info("a visitor is not told what was learned", reason=str(error))
        silent.append("learning")
    walker = stored.walker
    return OwnRecord(
        device=device,
        name=stored.name,
        platform=stored.platform,
        carrying=stored.carrying,  # type: ignore[arg-type]
        enrolled=stored.created,
        consents=[OwnConsent(version=version, given=given) for version, given in stored.consents],
        tokens=stored.tokens,
        transmitters=stored.transmitters,
        waiting=stored.waiting,
        trial_walks=None
        if walker is None
        else OwnSteps(peak=walker.peak, mean=walker.mean, slope=walker.slope, offset=walker.offset),
        position=gateway.positions.of(device, time.time()),
        alerts=gateway.alerts.of(device),
        learned=learned,
        kept=kept,
        silent=silent,
    )


async def _portions(
    record: OwnRecord, way: OwnWay | None, rest: Iterator[OwnWay], places: asyncio.Semaphore
) -> AsyncIterator[bytes]:
    """Yield an ``OwnExport`` as JSON, two days at a time, so that a long one is held by nobody as a whole."""
    yield b'{"record":' + encode(record) + b',"ways":['
    separator = b""
    while way is not None:
        yield separator + encode(way)
        separator = b","
        async with places:
            way = await asyncio.to_thread(next, rest, None)
    yield b"]}"
