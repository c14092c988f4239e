"""``/v1/erasures``: who withdrew consent, and which stores have nothing more of them."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict

import msgspec
from fastapi import APIRouter
from starlette.responses import Response

from services.api.erasure_replies import ErasureReport, Erasures, StoreErased
from services.api.openapi import documented
from shared.messages import Erasure, ErasureDone

__all__ = ["ErasureBoard", "erasure_reads"]

STORES = ("geofence", "history", "learning")
"""Services that keep something of devices beyond the moment; the gateway forgets before it tells."""
KEPT = 2000


class ErasureBoard:
    """What was told of erasures, the latest ``KEPT``; from any thread."""

    def __init__(self) -> None:
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
            rows = [
                ErasureReport(
                    device=device,
                    t=t,
                    done=[StoreErased(service=name, t=at) for name, at in sorted(self._done.get(device, {}).items())],
                    waiting=[name for name in STORES if name not in self._done.get(device, {})],
                )
                for device, t in self._withdrawn.items()
            ]
        return Erasures(t=now, erasures=sorted(rows, key=lambda row: row.t, reverse=True))


def erasure_reads(board: ErasureBoard) -> APIRouter:
    """Return the route."""
    router = APIRouter(prefix="/v1", tags=["privacy"], default_response_class=Response)

    @router.get("/erasures", responses=documented(Erasures))
    def erasures() -> Response:
        """Who withdrew consent in the last 30 days, which stores have erased them, and which have not said so yet."""
        return Response(msgspec.json.encode(board.report(time.time())), media_type="application/json")

    return router
