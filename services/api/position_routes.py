"""``/v1/positions``, ``/v1/tracks``, ``/v1/devices``: who is where, all of it or what a client asks for.

Without a query the first two are answered before they come here, from ready-made bytes.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable
from typing import Annotated, Any

import msgspec
from fastapi import APIRouter, Depends, Query, Request
from starlette.responses import Response

from services.api.admin.geojson import GEOJSON, Drawing, collection, drawing, placed, point
from services.api.examples import EXAMPLES
from services.api.live_state import LiveState
from services.api.openapi import UNCHANGED, documented
from services.api.openapi import drawn as drawn_too
from services.api.problems import unknown
from services.api.replies import Device, Devices, Position, Positions, Track, Tracks
from services.api.row_filters import Wanted, places, select, wanted
from services.api.seen import ALL, Seen, saw, saw_rows
from shared.site import Site
from shared.site.geographic import PlanOnEarth

__all__ = ["position_routes"]

Asked = Annotated[Wanted, Depends(wanted)]
Drawn = Annotated[Drawing, Depends(drawing)]


def position_routes(site: Site, live: LiveState) -> APIRouter:
    """Return the routes."""
    router = APIRouter(prefix="/v1", tags=["positions"], default_response_class=Response)
    areas = [area.id for area in site.areas]
    cameras = {camera.id for camera in site.cameras}
    floors = [floor.id for floor in site.floors]
    earth = PlanOnEarth.of(site)

    def features(rows: Iterable[Position | Track], drawn: Drawing) -> list[dict[str, Any]]:
        on_earth = placed(drawn.crs, earth)
        return [_feature(row, on_earth) for row in rows]

    a_position = _feature(msgspec.convert(EXAMPLES[Position], Position), None)
    a_track = _feature(msgspec.convert(EXAMPLES[Tracks], Tracks).tracks[0], None)

    @router.get(
        "/positions", responses=drawn_too(documented(Positions, 404, 422), collection([a_position])) | UNCHANGED
    )
    async def positions(request: Request, asked: Asked, drawn: Drawn) -> Response:
        """Where every located device is, or was last, while that is not too long ago (see age).

        Without parameters all of them; with any, those that match, by device, at most limit.
        """
        now = time.time()
        if not request.query_params and not drawn.geojson:
            saw(request, ALL)
            return _body(live.positions_json(now))
        rows, following = _devices(now, asked)
        saw_rows(request, [row.device for row in rows])
        if drawn.geojson:
            return _geojson(collection(features(rows, drawn), t=now, next=following))
        return _body(msgspec.json.encode(Positions(t=now, positions=rows, next=following)))

    @router.get("/positions/{device}", responses=drawn_too(documented(Position, 404, 422), a_position))
    async def position(request: Request, device: str, drawn: Drawn) -> Response:
        """Where one device is."""
        saw(request, Seen((device,)))
        found = live.position(device, time.time())
        if found is None:
            raise unknown("device", device)
        if drawn.geojson:
            return _geojson(features([found], drawn)[0])
        return _body(msgspec.json.encode(found))

    @router.get("/tracks", responses=drawn_too(documented(Tracks, 404, 422), collection([a_track])) | UNCHANGED)
    async def tracks(
        request: Request,
        asked: Asked,
        drawn: Drawn,
        area: Annotated[str | None, Query(description="only this area")] = None,
    ) -> Response:
        """Everybody, also people without a phone, in the newest frame of each area.

        Without parameters, or with area alone, all of them; with others those that match, at most limit.
        """
        if area is not None and area not in areas:
            raise unknown("area", area, areas)
        now = time.time()
        if set(request.query_params) <= {"area"} and not drawn.geojson:
            saw(request, ALL)
            return _body(live.tracks_json(area, now))
        rows, following = select(live.tracks(area, now), asked, live.zones, floors, _track_key, _quality)
        saw_rows(request, _named(rows, cameras))
        if drawn.geojson:
            return _geojson(collection(features(rows, drawn), t=now, next=following))
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


def _named(rows: Iterable[Track], cameras: Collection[str]) -> list[str | None]:
    """Return the phones that tracks name: whose they are, whose they may be, and what fed them besides cameras."""
    told = ((row.device, row.runner_up, *row.sources) for row in rows)
    return [name for names in told for name in names if name not in cameras]


def _track_key(row: Track) -> str:
    return f"{row.area}:{row.track:010d}"


def _quality(row: Track) -> float:
    return row.quality


def _feature(row: Position | Track, earth: PlanOnEarth | None) -> dict[str, Any]:
    return point(row.device if isinstance(row, Position) else f"{row.area}-{row.track}", row, earth)


def _geojson(body: dict[str, Any]) -> Response:
    return Response(msgspec.json.encode(body), media_type=GEOJSON)


def _body(content: bytes) -> Response:
    return Response(content, media_type="application/json")
