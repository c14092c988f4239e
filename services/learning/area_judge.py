"""How good an area's stretches are, under the radio model that is live there."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import structlog

from services.learning.report_draft import ReportDraft
from services.learning.tracks.quality import QualityJudge
from services.learning.tracks.sight import SightScore
from services.learning.tracks.stretch import Stretch
from services.learning.tracks.verdict import Verdict
from shared.messages import DetectionFrame, Message, RadioModelUpdate, TrackFrame
from shared.radio import PathLoss, RadioModelError, ShadowingMap, unpack_radio_model
from shared.site import Site, camera_views

__all__ = ["AreaJudge", "AreaSight"]

log = structlog.get_logger(__name__)


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
        self._radio: PathLoss = self._filed
        self._shadowing: ShadowingMap | None = None

    def __call__(self, stretch: Stretch) -> Verdict:
        """Return what is thought of a stretch."""
        return self._judge.judge(stretch, self._radio, self._shadowing)

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
        # As fusion has it: what was not located hangs where the site file says.
        located = np.isin(self._filed.names, model.model.located)
        places = np.where(located[:, None], known.path_loss.positions, self._filed.positions)
        self._radio = dataclasses.replace(known.path_loss, positions=places)
        self._shadowing = known.shadowing

    def forget(self, device: str) -> None:
        """Forget a phone whose owner withdrew consent."""
        self._judge.forget(device)

    def tell(self, draft: ReportDraft) -> None:
        """Add how many stretches were good, and why the others were not."""
        draft.area(self._area, tracks=self._judge.lessons())

    def state(self) -> dict[str, Any]:
        """Return all it knows, as what ``msgspec.json`` encodes."""
        return self._judge.state()

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from ``state()``, under the model that is live now.

        Raises:
            ValueError: it is no such state; the judge is then unchanged.
        """
        try:
            self._judge.restore(state, self._radio, self._shadowing)
        except (KeyError, TypeError) as error:
            raise ValueError(f"no state of a judge: {error}") from error


class AreaSight:
    """Scores one area's tracks by what its cameras say.

    Args:
        site: whose cameras.
        area: its id.
    """

    def __init__(self, site: Site, area: str) -> None:
        self._score = SightScore(camera_views(site, area).each)

    def take(self, frame: DetectionFrame) -> None:
        """Take in what one camera saw."""
        self._score.take_detections(frame)

    def score(self, frame: TrackFrame) -> Mapping[int, float]:
        """Return the nats by which cameras spoke for each track since the frame before."""
        return self._score.score(frame)
