"""The maps of one area as a learner: it proposes nothing, it is looked at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from services.learning.maps.area_maps import AreaMaps
from services.learning.proposal import Proposal
from services.learning.tracks.stretch import Stretch
from shared.learning_command import LearningAnswer, LearningCommand
from shared.learning_report import ModelKind
from shared.messages import Message, RadioModelUpdate, TrackFrame
from shared.radio.path_loss import PathLoss
from shared.radio.radio_model import RadioModel, RadioModelError, unpack_radio_model
from shared.site import Site

__all__ = ["MapsLearner"]

_NOTHING = {
    "visits": "Nobody has been seen here for long enough yet.",
    "occlusion": "Too few people have been seen here yet to tell where nobody walks.",
    "magnetic": "Nobody whose phone tells of the magnetic field has walked here yet.",
    "shadowing": "No radio model of this area is active: it is as the site file says, without shadowing.",
    "radio": "No access point stands on this floor.",
}


class MapsLearner:
    """Keeps the maps of one area up, frame by frame and stretch by stretch.

    Its kind is ``radio``, so that it hears which radio model went live; its pictures of radio are of that one.
    """

    kind: ModelKind = "radio"

    def __init__(self, site: Site, area: str) -> None:
        floor = site.area(area).floor
        self._filed = PathLoss.of([point for point in site.access_points if point.floor == floor])
        self._site = site.site
        self._area = area
        self._maps = AreaMaps.of_site(site, area)
        self._model: RadioModel | None = None

    def watch(self, message: Message) -> None:
        """Take in where cameras see people; other messages and other areas are left out."""
        if not isinstance(message, TrackFrame) or message.area != self._area:
            return
        seen = [row for row, state in enumerate(message.state) if state == "confirmed"]
        places = np.array([(message.x[row], message.y[row]) for row in seen], float).reshape(-1, 2)
        self._maps.look(message.t, places)

    def learn(self, stretch: Stretch) -> None:
        """Take in the magnetic field along a good stretch."""
        if len(stretch.magnetic):
            where = [np.interp(stretch.step_t, stretch.t, stretch.place[:, axis]) for axis in (0, 1)]
            self._maps.learn(np.column_stack(where), stretch.magnetic)

    def forget(self, device: str) -> None:
        """Nothing is kept by device."""

    def propose(self, now: float, until: float) -> Sequence[Proposal]:
        """Maps are looked at; nothing of theirs goes live."""
        return ()

    def activated(self, model: Message) -> None:
        """From now on pictures of radio are of this model; one that does not fit the site is passed over.

        Such a one is live where access points were added to the site file since: fusion does not use it either.
        """
        if not isinstance(model, RadioModelUpdate) or model.area != self._area:
            return
        self._model = None
        if model.model is not None:
            with suppress(RadioModelError):
                self._model = unpack_radio_model(model.model, self._site, self._filed.names).over(self._filed)

    def map(self, command: LearningCommand) -> LearningAnswer | None:
        """Answer an order for a map; None where it is of another area."""
        if command.area != self._area:
            return None
        if command.map is None:
            words = "map: is missing; allowed: visits, occlusion, radio, shadowing, magnetic"
            return LearningAnswer(done=False, words=words, field="map")
        try:
            grid = self._maps.grid(command.map, self._model, command.access_point)
        except ValueError as error:
            unknown = command.access_point is not None
            return LearningAnswer(done=False, words=str(error), field="access_point", unknown=unknown)
        words = "" if grid is not None else _NOTHING[command.map]
        point = command.access_point
        if command.map in ("radio", "shadowing") and point and not self._maps.placed(point, self._model):
            words = f"Nobody knows yet where access point {point} hangs."
        return LearningAnswer(done=True, words=words, map=grid)

    def state(self) -> dict[str, Any]:
        """Return all it knows, as what ``msgspec.json`` encodes."""
        return self._maps.state()

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            ValueError: it is no such state; nothing has changed then.
        """
        self._maps.restore(state)
