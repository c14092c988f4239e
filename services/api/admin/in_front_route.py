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
from services.api.in_front import Visitor, in_front
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
        field_of_view: Annotated[
            float,
            Query(ge=10.0, le=360.0, description="degrees, the whole of it, of who walks; who stands looks anywhere"),
        ] = 120.0,
        limit: Annotated[int, Query(ge=1, le=1000, description="at most this many")] = 10,
    ) -> Response:
        """What one visitor may be looking at, the most probable first; see probability."""
        saw(request, Seen((device,)))
        now = time.time()
        position = live.position(device, now)
        if position is None:
            raise unknown("device", device)
        heading = live.heading(device)
        here = [one for one in exhibits.definitions if one.floor == position.floor]
        towards, since = heading or (None, position.t)
        # From the wall clock, as age: nobody hears more of one who is lost, and what was known grows old all the same.
        stood = max(0.0, position.t - since) + position.age
        seen = in_front(
            Visitor((position.x, position.y), position.accuracy, towards, stood),
            math.radians(field_of_view),
            np.array([(one.x, one.y) for one in here], dtype=float).reshape(-1, 2),
            np.array([one.reach for one in here], dtype=float),
            np.radians([math.nan if one.facing is None else one.facing for one in here]),
            plans[position.floor],
        )
        columns = (seen.exhibit, seen.distance, seen.bearing, seen.probability)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        told = ExhibitsInFront(
            t=now,
            device=device,
            floor=position.floor,
            x=position.x,
            y=position.y,
            age=position.age,
            state=position.state,
            heading=None if towards is None else round(math.degrees(towards), 1),
            heading_age=None if towards is None else round(stood, 3),
            exhibits=[
                ExhibitInFront(
                    id=here[index].id,
                    name=here[index].name,
                    distance=round(distance, 2),
                    bearing=None if math.isnan(bearing) else round(math.degrees(bearing), 1),
                    probability=round(probability, 3),
                )
                for index, distance, bearing, probability in list(rows)[:limit]
            ],
        )
        return Response(msgspec.json.encode(told), media_type="application/json")

    return router
