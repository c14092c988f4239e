"""``/v1/positions``, ``/v1/tracks``, ``/v1/devices``: who is where, all of it or what a client asks for.

Without a query the first two are answered before they come here, from ready-made bytes.
"""

from __future__ import annotations

import time
from typing import Annotated

import msgspec
from fastapi import APIRouter, Depends, Query, Request
from starlette.responses import Response

from services.api.live_state import LiveState
from services.api.openapi import UNCHANGED, documented
from services.api.problems import unknown
from services.api.replies import Device, Devices, Position, Positions, Track, Tracks
from services.api.row_filters import Wanted, places, select, wanted
from services.api.seen import ALL, Seen, saw, saw_rows
from shared.site import Site

__all__ = ["position_routes"]

Asked = Annotated[Wanted, Depends(wanted)]


def position_routes(site: Site, live: LiveState) -> APIRouter:
    """Return the routes."""
    router = APIRouter(prefix="/v1", tags=["positions"], default_response_class=Response)
    areas = [area.id for area in site.areas]
    floors = [floor.id for floor in site.floors]

    @router.get("/positions", responses=documented(Positions, 404, 422) | UNCHANGED)
    async def positions(request: Request, asked: Asked) -> Response:
        """Where every located device is, or was last, while that is not too long ago (see age).

        Without parameters all of them; with any, those that match, by device, at most limit.
        """
        now = time.time()
        if not request.query_params:
            saw(request, ALL)
            return _body(live.positions_json(now))
        rows, following = _devices(now, asked)
        saw_rows(request, [row.device for row in rows])
        return _body(msgspec.json.encode(Positions(t=now, positions=rows, next=following)))

    @router.get("/positions/{device}", responses=documented(Position, 404))
    async def position(request: Request, device: str) -> Response:
        """Where one device is."""
        saw(request, Seen((device,)))
        found = live.position(device, time.time())
        if found is None:
            raise unknown("device", device)
        return _body(msgspec.json.encode(found))

    @router.get("/tracks", responses=documented(Tracks, 404, 422) | UNCHANGED)
    async def tracks(
        request: Request, asked: Asked, area: Annotated[str | None, Query(description="only this area")] = None
    ) -> Response:
        """Everybody, also people without a phone, in the newest frame of each area.

        Without parameters, or with area alone, all of them; with others those that match, at most limit.
        """
        if area is not None and area not in areas:
            raise unknown("area", area, areas)
        now = time.time()
        if set(request.query_params) <= {"area"}:
            saw(request, ALL)
            return _body(live.tracks_json(area, now))
        rows, following = select(live.tracks(area, now), asked, live.zones, floors, _track_key, _quality)
        saw_rows(request, [row.device for row in rows])
        return _body(msgspec.json.encode(Tracks(t=now, tracks=rows, next=following)))

    @router.get("/devices", responses=documented(Devices, 404, 422))
    async def devices(request: Request, asked: Asked) -> Response:
        """Every device that is located, or was lately: how surely, how fresh, and in which zones it is."""
        now = time.time()
        rows, following = _devices(now, asked)
        saw_rows(request, [row.device for row in rows])
        person, zone = live.zones.within(*places(rows))
        names = list(live.zones.ids)
        inside: dict[int, list[str]] = {}
        for row, index in zip(person.tolist(), zone.tolist(), strict=True):
            inside.setdefault(row, []).append(names[index])
        told = [
            Device(
                device=row.device,
                state=row.state,
                area=row.area,
                floor=row.floor,
                zones=sorted(inside.get(number, [])),
                probability=row.probability,
                t=row.t,
                age=row.age,
            )
            for number, row in enumerate(rows)
        ]
        return _body(msgspec.json.encode(Devices(t=now, devices=told, next=following)))

    def _devices(now: float, asked: Wanted) -> tuple[list[Position], str | None]:
        return select(
            live.positions(now), asked, live.zones, floors, lambda row: row.device, lambda row: row.probability
        )

    return router


def _track_key(row: Track) -> str:
    return f"{row.area}:{row.track:010d}"


def _quality(row: Track) -> float:
    return row.quality


def _body(content: bytes) -> Response:
    return Response(content, media_type="application/json")
