"""Which part of the floor does nobody see now? By the cameras that feed each area, and what they watch. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from shared.site import Site
from shared.site.footprint import footprint
from shared.zones import ZoneDefinition

__all__ = ["AreaSight", "Sight"]

BLIND_AFTER = 1.5
"""Seconds without a frame of a camera, by the time of measurement, after which it sees nothing."""
_BLIND_SHARE = 0.1
"""Of a zone that nobody sees, above which nobody knows how many are in it."""


class AreaSight:
    """What the cameras of one area see.

    Args:
        views: part of the floor that each camera watches, by id; an area without cameras has one, nameless.

    Attributes:
        blind: the cameras that see nothing now.
    """

    def __init__(self, views: Mapping[str, BaseGeometry]) -> None:
        self.views = views
        self.blind = frozenset(views)
        self._spoke: dict[str, float] = {}
        self._missed = frozenset(views)
        """The cameras that saw nothing before the newest frame."""
        self._seen: BaseGeometry = shapely.Polygon()

    def follow(self, views: Mapping[str, BaseGeometry]) -> None:
        """Take up other views; what a camera does not watch any more nobody saw there until the next frame."""
        self.blind = frozenset(name for name in views if name in self.blind or name not in self.views)
        self.views = views
        self._missed = frozenset(views)
        self._seen = shapely.Polygon()

    def look(self, t: float, cameras: Collection[str] | None) -> None:
        """Take in a frame at ``t`` s and which cameras fed it (None: it does not say, all).

        What a camera missed that was away is not known from its first picture: that hides what was hidden.
        """
        missed = self._silent(t)
        if missed != self._missed:
            self._missed = missed
            self._seen = shapely.union_all([view for name, view in self.views.items() if name not in missed])
        self._spoke |= dict.fromkeys(self.views if cameras is None else cameras, t)
        self.blind = self._silent(t)

    def lose(self) -> None:
        """Note that the area is silent: no camera of it sees anything."""
        self.blind = frozenset(self.views)

    def forget(self) -> None:
        """Begin anew: time ran back."""
        self._spoke.clear()

    def hidden(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which of (n,) places, metres, may be where a camera saw, and none until the newest frame."""
        if not self._missed:
            return np.zeros(len(x), np.bool_)
        seen: NDArray[np.bool_] = shapely.contains_xy(self._seen, x, y)
        return ~seen

    def _silent(self, t: float) -> frozenset[str]:
        return frozenset(name for name in self.views if t - self._spoke.get(name, -np.inf) > BLIND_AFTER)


class Sight:
    """What the cameras of a site see; ``areas``: by id."""

    def __init__(self, site: Site) -> None:
        self.areas = {area.id: AreaSight(_views(site, area.id)) for area in site.areas}
        self._floor = {area.id: area.floor for area in site.areas}

    def follow(self, site: Site) -> None:
        """Take up what the cameras of the same areas watch now."""
        for area, sight in self.areas.items():
            sight.follow(_views(site, area))

    def blind_zones(self, zones: Iterable[ZoneDefinition]) -> set[str]:
        """Return the ids of those zones, all of them areas, of which a part is seen by nobody."""
        unseen = {floor: self._unseen(floor) for floor in set(self._floor.values())}
        found = set()
        for zone in zones:
            part = unseen.get(zone.floor)
            if part is not None and not part.is_empty:
                shape = shapely.Polygon(zone.points)
                if shapely.area(shapely.intersection(shape, part)) > _BLIND_SHARE * shape.area:
                    found.add(zone.id)
        return found

    def _unseen(self, floor: str) -> BaseGeometry:
        here = [sight for area, sight in self.areas.items() if self._floor[area] == floor]
        blind = [view for sight in here for name, view in sight.views.items() if name in sight.blind]
        seen = [view for sight in here for name, view in sight.views.items() if name not in sight.blind]
        return shapely.difference(shapely.union_all(blind), shapely.union_all(seen))


def _views(site: Site, area: str) -> dict[str, BaseGeometry]:
    outline = site.floor(site.area(area).floor).plan().outline
    views: dict[str, BaseGeometry] = {}
    for camera in site.cameras_of(area):
        ring = footprint(camera.geometry.build(), camera.area_of_interest, outline)
        views[camera.id] = shapely.make_valid(shapely.Polygon(ring)) if len(ring) > 2 else shapely.Polygon()
    return views or {"": outline}
