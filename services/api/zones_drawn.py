"""How many people are in each zone now? All positions against all zones at once, in a tree of their bounds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import numpy as np
import shapely
from numpy.typing import NDArray

from services.api.replies import ZoneReport
from shared.site import Site
from shared.zones import ZoneDefinition, ZoneRule

__all__ = ["People", "ZonesDrawn", "zones_of"]

_COUNTS = b'"inside":%d,"unseen":%d'
"""As ``ZoneReport`` writes its two fields; what follows them is a tag, which holds no such text."""


def zones_of(site: Site) -> list[ZoneDefinition]:
    """Return the zones of a site file, what it lets be told as rules called ``enter`` and ``exit``."""
    return [
        ZoneDefinition(
            id=zone.id,
            name=zone.name,
            floor=zone.floor,
            points=zone.polygon,
            rules=[ZoneRule(id=kind, kind=kind) for kind in zone.alert_on],
        )
        for zone in site.zones
    ]


class People(NamedTuple):
    """Where everybody is: floors, metres on the plan, and whether no camera sees them; arrays of one length."""

    floor: NDArray[np.object_]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    unseen: NDArray[np.bool_]


class ZonesDrawn:
    """The zones that hold now, ready to be asked who is in them.

    Args:
        zones: in the order in which they are told.
        etags: of each; without them they cannot be changed.
    """

    def __init__(self, zones: Sequence[ZoneDefinition], etags: Sequence[str] | None = None) -> None:
        self.ids = {zone.id: number for number, zone in enumerate(zones)}
        self._floor = np.array([zone.floor for zone in zones], dtype=object)
        # A line holds nobody: it stands in the tree as nothing.
        areas = [shapely.Polygon(zone.points if zone.shape == "area" else None) for zone in zones]
        self._areas = np.array(areas, dtype=object)
        shapely.prepare(self._areas)
        self._tree = shapely.STRtree(areas)
        self._empty = [
            ZoneReport(
                id=zone.id,
                name=zone.name,
                floor=zone.floor,
                shape=zone.shape,
                points=zone.points,
                rules=zone.rules,
                polygon=zone.points,
                alert_on=[rule.kind for rule in zone.rules if rule.kind == "enter" or rule.kind == "exit"],
                inside=0,
                unseen=0,
                etag=etag,
            )
            for zone, etag in zip(zones, etags or [""] * len(zones), strict=True)
        ]
        self._pieces = [b""]
        """The JSON of all reports: what comes before, between and after the counts, in every other place."""
        for report in self._empty:
            before, _, after = msgspec.json.encode(report).rpartition(_COUNTS % (0, 0))
            self._pieces[-1] += before
            self._pieces += [b"", after + b","]
        self._pieces[-1] = self._pieces[-1].removesuffix(b",")

    def within(
        self, floor: NDArray[np.object_], x: NDArray[np.float64], y: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return pairs (person, zone) of whose place, its floor and metres, lies in which zone, borders included."""
        person, zone = self._tree.query(shapely.points(x, y))
        same = self._floor[zone] == floor[person]
        person, zone = person[same], zone[same]
        within = shapely.intersects_xy(self._areas[zone], x[person], y[person])
        return person[within], zone[within]

    def reports(self, people: People) -> list[ZoneReport]:
        """Return each zone with how many of these people are in it, those whom no camera sees apart."""
        return [
            report if not (seen or not_seen) else msgspec.structs.replace(report, inside=seen, unseen=not_seen)
            for report, (seen, not_seen) in zip(self._empty, self._counts(people), strict=True)
        ]

    def reports_json(self, people: People) -> bytes:
        """Return ``reports`` as JSON; shapes and rules, which may be long, are not written anew."""
        pieces = self._pieces.copy()
        pieces[1::2] = [_COUNTS % counts for counts in self._counts(people)]
        return b"[%b]" % b"".join(pieces)

    def _counts(self, people: People) -> list[tuple[int, int]]:
        """Return of each zone how many are in it whom cameras see, and whom none does."""
        person, zone = self.within(people.floor, people.x, people.y)
        hidden = people.unseen[person]
        seen = np.bincount(zone[~hidden], minlength=len(self._empty)).tolist()
        out_of_view = np.bincount(zone[hidden], minlength=len(self._empty)).tolist()
        return list(zip(seen, out_of_view, strict=True))
