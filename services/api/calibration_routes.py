"""``/v1/cameras/{id}/still``, ``…/board``, ``…/calibration`` and ``/v1/access-points``: setting a site up in a browser.

Pictures need the scope ``stills``, saving needs ``setup``; both are in no key that does not name them.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, TypeVar

from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from services.api.auth import Holder, needs, too_many
from services.api.calibration_replies import (
    CALIBRATION_EXAMPLES,
    BoardCorners,
    CalibrationSave,
    CalibrationSaved,
    CalibrationTrial,
    CalibrationTry,
    CalibrationView,
    Placement,
    Placements,
    PlacementSave,
    StillOpened,
)
from services.api.calibration_saving import (
    calibration_view,
    check_inside,
    lens_of,
    save_calibration,
    unfit,
)
from services.api.calibration_trial import all_pairs, try_pairs
from services.api.camera_link import CameraLink
from services.api.json_answer import unkept_answer
from services.api.live_state import LiveState
from services.api.openapi import documented, errors
from services.api.problems import ProblemError, unknown
from services.api.request_body import described, read_struct
from services.api.seen import Seen, saw
from services.api.setup_desk import SetupDesk
from shared.keys import Keys
from shared.site import Camera, Site
from shared.site.camera_geometry import GeometryError

__all__ = ["calibration_routes"]

LARGEST = 1 << 20
"""Bytes of a body."""
PICTURE = Seen(picture=True)
PLACED = (
    "Saved, and in use within seconds: nothing need be started again. Fusion of {} begins anew with it: everybody "
    "there gets a new number, and phones find their people again."
)

T = TypeVar("T")

MOST_WAITING = 4
"""Fits of cameras that wait or run."""

_JPEG: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The camera's newest picture; X-Atrium-Taken says when it was taken, seconds since the epoch.",
        "content": {"image/jpeg": {"schema": {"type": "string", "format": "binary"}, "example": "(a JPEG)"}},
    }
}


def calibration_routes(
    site: Site,
    site_file: Path,
    ask: Callable[[str, float, bytes | None], bytes | None],
    live: LiveState,
    told: Callable[[], None],
) -> APIRouter:
    """Return the routes.

    Args:
        site: as read at the start.
        site_file: beside it is saved.
        ask: sends a query over the bus.
        live: knows which calibration each camera uses.
        told: called after something was saved: tells it to all.
    """
    router = APIRouter(prefix="/v1", tags=["set-up"], default_response_class=Response)
    fitting = _Turns()
    link, desk = CameraLink(Keys(site.site), ask), SetupDesk(site_file, site, told)

    @router.post("/cameras/{camera}/still", responses=documented(StillOpened, 404, 409, 422, 429, 503))
    def open_stills(request: Request, camera: str) -> Response:
        """Allow stills of a camera for some minutes; the camera's setting allow_stills must be on."""
        needs(request.state.holder, "stills")
        _camera(site, camera)
        answer = link.ask(camera, "open", _name(request))
        return unkept_answer(StillOpened(words=answer.words, until=answer.until))

    @router.get("/cameras/{camera}/still", responses=_JPEG | errors(404, 409, 422, 429, 503))
    def still(request: Request, camera: str) -> Response:
        """One picture of a camera for its calibration, while stills are open; each is noted with the key's name."""
        needs(request.state.holder, "stills")
        _camera(site, camera)
        saw(request, PICTURE)
        answer = link.ask(camera, "look", _name(request))
        headers = {"Cache-Control": "no-store", "X-Atrium-Taken": f"{answer.t:.3f}"}
        return Response(answer.jpeg, media_type="image/jpeg", headers=headers)

    @router.get("/cameras/{camera}/board", responses=documented(BoardCorners, 404, 409, 422, 429, 503))
    def board(
        request: Request,
        camera: str,
        columns: Annotated[int, Query(ge=3, le=30, description="inner corners in a row: squares less one")],
        rows: Annotated[int, Query(ge=3, le=30, description="rows of them")],
    ) -> Response:
        """Find a checkerboard that lies on the floor in the camera's newest picture, while stills are open."""
        needs(request.state.holder, "stills")
        _camera(site, camera)
        saw(request, PICTURE)
        answer = link.ask(camera, "board", _name(request), columns, rows)
        return unkept_answer(BoardCorners(image_size=(answer.width, answer.height), corners=answer.corners))

    @router.get("/cameras/{camera}/calibration", responses=documented(CalibrationView, 404, 409))
    def calibration(camera: str) -> Response:
        """How a camera is calibrated: as saved in the browser, or else as the site file says."""
        return unkept_answer(calibration_view(site, desk, live, _camera(site, camera)))

    @router.post(
        "/cameras/{camera}/calibration/try",
        responses=documented(CalibrationTrial, 404, 409, 413, 422, 429),
        openapi_extra=described(CalibrationTry, CALIBRATION_EXAMPLES[CalibrationTry]),
    )
    async def attempt(request: Request, camera: str) -> Response:
        """Fit a camera to pairs: residuals, a suspected wrong click, the floor's grid in the picture; stores none."""
        needs(request.state.holder, "setup")
        named = _camera(site, camera)
        order = await read_struct(request, CalibrationTry, LARGEST)

        def work() -> CalibrationTrial:
            lens = lens_of(desk, named, order.image_size) if order.use_lens else None
            floor = site.floor(site.area(named.area).floor)
            try:
                image, plan = all_pairs(order)
                check_inside(image, order.image_size)
                return try_pairs(camera, floor, order.image_size, image, plan, lens)
            except (GeometryError, ValueError) as error:
                raise unfit(str(error)) from error

        return unkept_answer(await fitting.run(work))

    @router.post(
        "/cameras/{camera}/calibration",
        responses=documented(CalibrationSaved, 404, 409, 413, 422, 429, 503),
        openapi_extra=described(CalibrationSave, CALIBRATION_EXAMPLES[CalibrationSave]),
    )
    async def save(request: Request, camera: str) -> Response:
        """Save a calibration and the area of interest beside the site file; the one before is kept."""
        needs(request.state.holder, "setup")
        named = _camera(site, camera)
        order = await read_struct(request, CalibrationSave, LARGEST)

        def work() -> CalibrationSaved:
            return save_calibration(site, desk, live, named, order, _name(request))

        return unkept_answer(await fitting.run(work))

    @router.get("/access-points", responses=documented(Placements, 409))
    def placements() -> Response:
        """Where the access points hang: as placed in the browser, or else as the site file says."""
        placed = desk.read().access_points
        return unkept_answer(
            Placements(
                access_points=[
                    Placement(
                        id=point.id,
                        floor=point.floor,
                        kind=point.kind,
                        position=placed[point.id].position if point.id in placed else point.position,
                        saved=placed[point.id].saved if point.id in placed else None,
                    )
                    for point in site.access_points
                ]
            )
        )

    @router.post(
        "/access-points",
        responses=documented(CalibrationSaved, 404, 409, 413, 422, 503),
        openapi_extra=described(PlacementSave, CALIBRATION_EXAMPLES[PlacementSave]),
    )
    async def place(request: Request) -> Response:
        """Save where access points hang beside the site file; null: as the site file says."""
        needs(request.state.holder, "setup")
        order = await read_struct(request, PlacementSave, LARGEST)
        known = {point.id: point for point in site.access_points}
        for name in order.positions:
            if name not in known:
                raise unknown("access point", name, list(known))

        request.state.audit = ", ".join(order.positions)

        def work() -> CalibrationSaved:
            version = desk.place(order.positions, _name(request))
            floors = {known[name].floor for name in order.positions}
            areas = [area.id for area in site.areas if area.floor in floors]
            return CalibrationSaved(words=PLACED.format(", ".join(areas) or "no area"), version=version)

        return unkept_answer(await run_in_threadpool(work))

    return router


class _Turns:
    """Lets one fit run at a time: many pairs that do not fit each other take seconds of a processor."""

    def __init__(self) -> None:
        self._free = asyncio.Lock()
        self._waiting = 0

    async def run(self, work: Callable[[], T]) -> T:
        """Do the work in a thread when it is its turn.

        Raises:
            ProblemError: too many wait already.
        """
        if self._waiting >= MOST_WAITING:
            problem, headers = too_many(f"{MOST_WAITING} fits of cameras wait already", 5.0)
            raise ProblemError(problem, headers)
        self._waiting += 1
        try:
            async with self._free:
                return await run_in_threadpool(work)
        finally:
            self._waiting -= 1


def _camera(site: Site, camera: str) -> Camera:
    known = [one.id for one in site.cameras]
    if camera not in known:
        raise unknown("camera", camera, known)
    return site.camera(camera)


def _name(request: Request) -> str:
    holder: Holder = request.state.holder
    return holder.name
