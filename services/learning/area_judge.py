"""How good an area's stretches are, under the radio model that is live there, and how right its names."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import structlog

from services.learning.accuracy.self_report import SelfReport
from services.learning.cameras.camera_scores import CameraScores
from services.learning.radio.by_name import columns_today
from services.learning.report_draft import ReportDraft
from services.learning.tracks.quality import QualityJudge
from services.learning.tracks.sight import SightScore
from services.learning.tracks.stretch import Stretch
from services.learning.tracks.verdict import Verdict
from shared.messages import DetectionFrame, Message, MotionBatch, RadioModelUpdate, RadioScan, TrackFrame
from shared.radio import PathLoss, RadioModelError, ShadowingMap, unpack_radio_model
from shared.site import Site, camera_views

__all__ = ["AreaJudge", "AreaSight"]

log = structlog.get_logger(__name__)

EVERY = 1.0
"""Seconds between two looks at the names that have become old enough."""


class AreaJudge:
    """Judges the stretches of one area.

    Args:
        site: whose access points.
        area: its id.
    """

    def __init__(self, site: Site, area: str) -> None:
        floor = site.area(area).floor
        self._site, self._area = site.site, area
        self._filed = PathLoss.of([point for point in site.access_points if point.floor == floor])
        self._judge = QualityJudge(len(self._filed.names))
        self._names = SelfReport.of(site, area)
        self._looked = -math.inf
        self._radio: PathLoss = self._filed
        self._shadowing: ShadowingMap | None = None

    def __call__(self, stretch: Stretch) -> Verdict:
        """Return what is thought of a stretch."""
        return self._judge.judge(stretch, self._radio, self._shadowing)

    def watch(self, message: Message) -> None:
        """Take in who was told to be where, and what phones say afterwards."""
        match message:
            case TrackFrame():
                self._names.take_frame(message)
                if not 0.0 <= message.t - self._looked < EVERY:
                    self._looked = message.t
                    self._names.judge(self._radio, self._shadowing, self._judge.belief)
            case RadioScan():
                self._names.take_scan(message)
            case MotionBatch():
                self._names.take_motion(message)
            case _:
                pass

    def activated(self, model: Message) -> None:
        """Judge under a radio model that went live."""
        if not isinstance(model, RadioModelUpdate) or model.area != self._area:
            return
        if model.model is None:
            self._radio, self._shadowing = self._filed, None
            return
        try:
            known = unpack_radio_model(model.model, self._site, self._filed.names)
        except RadioModelError as error:
            log.warning("a live radio model cannot be used to judge", area=self._area, reason=str(error))
            return
        self._radio, self._shadowing = known.over(self._filed).path_loss, known.shadowing

    def forget(self, device: str) -> None:
        """Forget a phone whose owner withdrew consent."""
        self._judge.forget(device)
        self._names.forget(device)

    def tell(self, draft: ReportDraft) -> None:
        """Add how many stretches were good, why the others were not, and how far off names are believed to be."""
        draft.area(self._area, tracks=self._judge.lessons(), accuracy=self._names.report())

    def state(self) -> dict[str, Any]:
        """Return all it knows, as what ``msgspec.json`` encodes."""
        return {"access_points": list(self._filed.names), **self._judge.state()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from ``state()``, under the model that is live now; access points are known again by their names.

        Raises:
            ValueError: it is no such state; the judge is then unchanged.
        """
        self._judge.restore(state, columns_today(state.get("access_points", ()), self._filed.names))


class AreaSight:
    """Scores one area's tracks by what its cameras say.

    Args:
        site: whose cameras.
        area: its id.
    """

    def __init__(self, site: Site, area: str) -> None:
        self._score = SightScore(camera_views(site, area).each)
        self._area = area
        self._cameras = [camera.id for camera in site.cameras_of(area)]
        self._kept = CameraScores(self._cameras)

    def take(self, frame: DetectionFrame) -> None:
        """Take in what one camera saw."""
        self._score.take_detections(frame)

    def score(self, frame: TrackFrame) -> Mapping[int, float]:
        """Return the nats by which cameras spoke for each track since the frame before."""
        sight = self._score.score(frame)
        self._kept.take(frame, sight)
        return sight

    def tell(self, draft: ReportDraft) -> None:
        """Add how well each camera's detections spoke for its tracks, over time."""
        for camera in self._cameras:
            t, score = self._kept.of(camera)
            draft.camera(camera, self._area, score_t=t, score=score)
