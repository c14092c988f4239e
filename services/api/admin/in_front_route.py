"""``/v1/positions/{device}/exhibits``: what a guide app asks when its visitor stops."""

from __future__ import annotations

import math
import time
from typing import Annotated

import msgspec
import numpy as np
from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from services.api.admin.catalogue import Catalogue
from services.api.admin.exhibits import ExhibitDefinition
from services.api.admin.replies import ExhibitInFront, ExhibitsInFront
from services.api.in_front import in_front
from services.api.live_state import LiveState
from services.api.openapi import documented
from services.api.problems import unknown
from services.api.seen import Seen, saw
from shared.site import Site

__all__ = ["in_front_route"]


def in_front_route(site: Site, live: LiveState, exhibits: Catalogue[ExhibitDefinition]) -> APIRouter:
    """Return the route."""
    router = APIRouter(prefix="/v1", default_response_class=Response)
    plans = {floor.id: floor.plan() for floor in site.floors}

    @router.get("/positions/{device}/exhibits", tags=["exhibits"], responses=documented(ExhibitsInFront, 404, 422))
    async def exhibits_in_front(
        request: Request,
        device: str,
        field_of_view: Annotated[float, Query(ge=10.0, le=360.0, description="degrees, the whole of it")] = 120.0,
        limit: Annotated[int, Query(ge=1, le=1000, description="at most this many")] = 10,
    ) -> Response:
        """What is in front of one visitor, nearest first; where nobody knows which way they look, what is near."""
        saw(request, Seen((device,)))
        now = time.time()
        position = live.position(device, now)
        if position is None:
            raise unknown("device", device)
        heading = live.heading(device)
        here = [one for one in exhibits.definitions if one.floor == position.floor]
        xx, xy, yy = position.covariance
        seen = in_front(
            (position.x, position.y),
            math.sqrt(max(0.0, (xx + yy) / 2.0 + math.hypot((xx - yy) / 2.0, xy))),
            None if heading is None else heading[0],
            math.radians(field_of_view),
            np.array([(one.x, one.y) for one in here], dtype=float).reshape(-1, 2),
            np.array([one.reach for one in here], dtype=float),
            np.radians([math.nan if one.facing is None else one.facing for one in here]),
            plans[position.floor],
        )
        rows = zip(seen.exhibit.tolist(), seen.distance.tolist(), seen.bearing.tolist(), strict=True)
        told = ExhibitsInFront(
            t=now,
            device=device,
            floor=position.floor,
            x=position.x,
            y=position.y,
            age=position.age,
            heading=None if heading is None else round(math.degrees(heading[0]), 1),
            heading_age=None if heading is None else round(max(0.0, position.t - heading[1]), 3),
            exhibits=[
                ExhibitInFront(
                    id=here[index].id,
                    name=here[index].name,
                    distance=round(distance, 2),
                    bearing=None if math.isnan(bearing) else round(math.degrees(bearing), 1),
                )
                for index, distance, bearing in list(rows)[:limit]
            ],
        )
        return Response(msgspec.json.encode(told), media_type="application/json")

    return router
