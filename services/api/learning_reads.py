"""``/v1/learning``: what is learned, how well, and why."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Annotated

from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from services.api.auth import Holder, needs
from services.api.json_answer import json_answer
from services.api.learning_link import LearningLink
from services.api.learning_replies import (
    AccessPointOfArea,
    AccuracyOfArea,
    Learning,
    LearningAccessPoints,
    LearningAccuracy,
    LearningCameras,
    LearningDevices,
    LearningHistory,
)
from services.api.openapi import documented
from services.api.problems import unknown
from services.api.seen import ALL, saw
from shared.learning_command import LearningCommand
from shared.learning_report import Activation, AreaLessons, ModelKind
from shared.site import Site

__all__ = ["learning_reads"]

NEWEST = 50
"""Decisions told by ``GET /v1/learning``."""
PERSONAL: frozenset[ModelKind] = frozenset({"stride", "heading"})
"""Models of one phone."""


def learning_reads(site: Site, link: LearningLink) -> APIRouter:
    """Return the routes that read; ``site`` is there to check ids that clients name."""
    router = APIRouter(prefix="/v1/learning", tags=["learning"], default_response_class=Response)
    areas = [area.id for area in site.areas]

    @router.get("", responses=documented(Learning, 503))
    def everything(request: Request) -> Response:
        """What is being learned, all of it; single phones only with a key that may read positions, too."""
        report, holder = link.report(), _holder(request)
        personal = "positions" in holder.scopes
        if personal:
            saw(request, ALL)
        return json_answer(
            Learning(
                t=report.t,
                frozen=report.frozen,
                may_change="learning-admin" in holder.scopes,
                areas=report.areas,
                cameras=report.cameras,
                devices=report.devices if personal else [],
                history=_told(report.history, personal)[:NEWEST],
            )
        )

    @router.get("/areas/{area}", responses=documented(AreaLessons, 404, 503))
    def of_area(area: str) -> Response:
        """What is learned of one area."""
        if area not in areas:
            raise unknown("area", area, areas)
        found = next((lessons for lessons in link.report().areas if lessons.area == area), AreaLessons(area=area))
        return json_answer(found)

    @router.get("/access-points", responses=documented(LearningAccessPoints, 404, 503))
    def access_points(area: Annotated[str | None, Query(description="only of this area's model")] = None) -> Response:
        """How well the active radio model explains each access point, and which have changed or fallen silent."""
        if area is not None and area not in areas:
            raise unknown("area", area, areas)
        report = link.report()
        rows = [
            AccessPointOfArea(area=lessons.area, version=lessons.version, fit=fit)
            for lessons in report.areas
            if area in (None, lessons.area)
            for fit in lessons.access_points
        ]
        return json_answer(LearningAccessPoints(t=report.t, access_points=rows))

    @router.get("/cameras", responses=documented(LearningCameras, 503))
    def cameras() -> Response:
        """How each camera's tracks score over time, whether it was knocked, how its clock stands to phones'."""
        report = link.report()
        return json_answer(LearningCameras(t=report.t, cameras=report.cameras))

    @router.get("/devices", responses=documented(LearningDevices, 503))
    def devices(request: Request) -> Response:
        """Each phone's stride line, heading bias and radio offset; needs the scope positions too."""
        needs(_holder(request), "positions")
        saw(request, ALL)
        report = link.report()
        return json_answer(LearningDevices(t=report.t, devices=report.devices))

    @router.get("/accuracy", responses=documented(LearningAccuracy, 503))
    def accuracy() -> Response:
        """How far off Atrium believes its named positions to be, by area."""
        report = link.report()
        rows = [AccuracyOfArea(area=lessons.area, accuracy=lessons.accuracy) for lessons in report.areas]
        return json_answer(LearningAccuracy(t=report.t, areas=rows))

    @router.get("/history", responses=documented(LearningHistory, 422, 503))
    def history(
        request: Request,
        before: Annotated[
            float | None, Query(allow_inf_nan=False, description="only decisions before this time: the next page")
        ] = None,
        kind: Annotated[ModelKind | None, Query(description="only of this kind of model")] = None,
        subject: Annotated[str | None, Query(description="only of this area, camera or device")] = None,
        limit: Annotated[int, Query(ge=1, le=1000, description="at most this many, but never half a moment")] = 100,
    ) -> Response:
        """What went live, what was refused and what was taken back, and why; newest first."""
        personal = "positions" in _holder(request).scopes
        if personal:
            saw(request, ALL)
        told = link.history(
            LearningCommand(do="history", kind=kind, subject=subject, before=before, most=limit, personal=personal)
        )
        page = _told(told.history, personal)
        return json_answer(
            LearningHistory(t=time.time(), history=page, next=page[-1].t if told.older and page else None)
        )

    return router


def _holder(request: Request) -> Holder:
    holder: Holder = request.state.holder
    return holder


def _told(history: Sequence[Activation], personal: bool) -> list[Activation]:
    return [row for row in history if personal or row.kind not in PERSONAL]
