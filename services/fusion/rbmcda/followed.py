"""What did the cameras see at the end of a cycle, and which of it is the same person as a cycle before?

A cycle of one second holds up to thirty frames of each camera. The anonymous layer follows people through all of them,
as it does for every tracker; a sighting of the filter is one of its tracks at the end of the cycle, and the track's id
is the link that makes it the same person as before. Links from frame to frame that end wherever a detection flickers
or two people come near (``SightingLinks``, which the vision-only filter uses) left five people two new links a second
on the building sites, and at each the identity was open anew."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.fusion.area_view import AreaView
from services.fusion.positions.anonymous import AnonymousLayer
from services.fusion.rbmcda.settings import RbmcdaSettings
from services.fusion.rbmcda.sightings import Sightings
from services.fusion.rbmcda.walk_evidence import WalkEvidence
from shared.messages import DetectionFrame

__all__ = ["FollowedPeople"]

Array = NDArray[np.float64]

PATH = 0.19
"""Seconds after which a path gets its next place."""


class FollowedPeople:
    """The people of an area, as the filter is shown them.

    Attributes:
        walks: what phones' walks say for each of them.
    """

    def __init__(self, view: AreaView, settings: RbmcdaSettings) -> None:
        self.walks = WalkEvidence()
        self._layer = AnonymousLayer(view)
        self._settings = settings
        self._told_since: dict[int, float] = {}
        self._told_last: list[int] = []

    def cycle(self, frames: Sequence[DetectionFrame], t: float) -> tuple[Sightings, int]:
        """Return who is seen at ``t``, the end of a cycle, and how many detections made no sense."""
        layer = self._layer
        nonsense = sum(layer.ignored.values())
        layer.begin_chunk()
        noted = -math.inf
        for frame in sorted(frames, key=lambda frame: (frame.t, frame.camera)):
            layer.observe(frame)
            if frame.t >= noted + PATH:
                noted = frame.t
                self._follow(frame.t)
        self._follow(t)
        tracks = layer.tracks
        told = np.flatnonzero(layer.told())
        links = tracks.ids[told]
        # The cycle before is worked on now: whoever was told of then, and is gone, has an age there still.
        since = {link: self._told_since[link] for link in self._told_last}
        self._told_last = links.tolist()
        self._told_since = since | {link: self._told_since.get(link, t) for link in self._told_last}
        sightings = Sightings(
            places=tracks.mean[told, :2],
            noise=tracks.spread()[told],
            link=links,
            cameras=layer.names_of(tracks.fed[told].tolist()),
        )
        return sightings, sum(layer.ignored.values()) - nonsense

    def pickup(self, t: float, links: NDArray[np.int64]) -> Array:
        """Return (d,) how readily a device that was on nobody is taken for each: less who is followed for long."""
        s = self._settings
        age = t - np.array([self._told_since.get(link, -math.inf) for link in links.tolist()])
        rate: Array = np.where(age <= s.young, 1.0, s.pickup)
        return rate

    def state(self) -> dict[str, Any]:
        """Return a copy of all that is known."""
        return {
            "layer": self._layer.state(),
            "walks": self.walks.state(),
            "told_since": [[link, t] for link, t in self._told_since.items()],
            "told_last": list(self._told_last),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from ``state()``."""
        self._layer.restore(state["layer"])
        self.walks.restore(state["walks"])
        self._told_since = {int(link): float(t) for link, t in state["told_since"]}
        self._told_last = [int(link) for link in state["told_last"]]

    def _follow(self, t: float) -> None:
        tracks = self._layer.tracks
        sure = tracks.confirmed
        self.walks.follow(t, tracks.ids[sure], tracks.mean[sure, :2])
