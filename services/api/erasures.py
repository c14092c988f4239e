"""``/v1/erasures``: who withdrew consent, and which stores have nothing more of them; staff end one for a visitor."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Collection, Iterable

import msgspec
from fastapi import APIRouter, Request
from starlette.responses import Response

from services.api.auth import Holder
from services.api.erasure_replies import ErasureReport, Erasures, StoreErased
from services.api.openapi import accepted, documented
from services.api.seen import ALL, saw
from shared.messages import Erasure, ErasureDone

__all__ = ["ErasureBoard", "OwnErasures", "erasure_routes"]

STORES = ("api", "geofence", "history", "learning")
"""Services that keep something of devices, beside fusion's of each area; the gateway forgets before it tells."""
KEPT = 2000


class ErasureBoard:
    """What was told of erasures, the latest ``KEPT``; from any thread.

    Args:
        areas: of the site, each with a fusion service.
    """

    def __init__(self, areas: Iterable[str]) -> None:
        self._stores = sorted([*STORES, *(f"fusion-{area}" for area in areas)])
        self._lock = threading.Lock()
        self._withdrawn: OrderedDict[str, float] = OrderedDict()
        self._done: dict[str, dict[str, float]] = {}

    def take(self, told: Erasure | ErasureDone) -> None:
        """Note a withdrawal, or that a store has carried it out."""
        with self._lock:
            if isinstance(told, ErasureDone):
                self._done.setdefault(told.device, {}).setdefault(told.service, told.t)
            self._withdrawn[told.device] = min(self._withdrawn.get(told.device, told.t), told.t)
            while len(self._withdrawn) > KEPT:
                self._done.pop(self._withdrawn.popitem(last=False)[0], None)

    def report(self, now: float) -> Erasures:
        """Return all of it, the latest first."""
        with self._lock:
            rows = [self._row(device, t) for device, t in self._withdrawn.items()]
        return Erasures(t=now, erasures=sorted(rows, key=lambda row: row.t, reverse=True))

    def one(self, device: str, t: float) -> ErasureReport:
        """Return what is known of one device's erasure, which was ordered at ``t``."""
        with self._lock:
            return self._row(device, min(self._withdrawn.get(device, t), t))

    def _row(self, device: str, t: float) -> ErasureReport:
        done = self._done.get(device, {})
        return ErasureReport(
            device=device,
            t=t,
            done=[StoreErased(service=name, t=at) for name, at in sorted(done.items())],
            waiting=[name for name in self._stores if name not in done],
        )


class OwnErasures:
    """What the API itself has erased: it says so once each of its parts has; from any thread.

    Args:
        parts: their names.
        tell: called with a device of which none of them has anything more.
    """

    def __init__(self, parts: Collection[str], tell: Callable[[str], None]) -> None:
        self._parts = frozenset(parts)
        self._tell = tell
        self._lock = threading.Lock()
        self._done: dict[str, set[str]] = {}

    def of(self, part: str) -> Callable[[str], None]:
        """Return what a part calls with a device that it has erased."""

        def done(device: str) -> None:
            with self._lock:
                parts = self._done.setdefault(device, set())
                parts.add(part)
                if parts < self._parts:
                    return
                del self._done[device]
            self._tell(device)

        return done


def erasure_routes(board: ErasureBoard, withdraw: Callable[[str, str], float]) -> APIRouter:
    """Return the routes; ``withdraw`` ends a device's consent for one of the staff and returns when it ended, s."""
    router = APIRouter(prefix="/v1", tags=["privacy"], default_response_class=Response)

    @router.get("/erasures", responses=documented(Erasures))
    def erasures(request: Request) -> Response:
        """Who withdrew consent in the last 30 days, which stores have erased them, and which have not said so yet."""
        saw(request, ALL)
        return Response(msgspec.json.encode(board.report(time.time())), media_type="application/json")

    @router.delete("/devices/{device}", status_code=202, responses=accepted(ErasureReport, 404, 503))
    def erase(device: str, request: Request) -> Response:
        """End a phone's consent for a visitor who asks, as their own app would: needs the scope `erase`.

        Its tokens are dead when this answers; `GET /v1/erasures` tells which stores have erased it. Asked again it
        does nothing more and answers the same.
        """
        holder: Holder = request.state.holder
        report = board.one(device, withdraw(device, holder.name))
        return Response(msgspec.json.encode(report), 202, {"Cache-Control": "no-store"}, "application/json")

    return router
