"""What is watched: zones and their rules as borders to test and rules of each border.

A zone is one border for every confidence its rules ask for; of every area the border of a half is there, for counting.
What cannot be watched is left out and said in plain words; the other zones are watched all the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely

from services.geofence.borders import Borders
from services.geofence.evidence import SURE
from services.geofence.zone_index import Box, ZoneIndex
from shared.site import Site, Zone
from shared.zones import ZoneDefinition, ZoneRule

__all__ = ["MOST_ZONES", "Rule", "ZonePlan", "of_site"]

EVEN = 0.5
"""The confidence of counting: more probably inside than not."""
MOST_SPREAD = 0.5
"""Metres, standard deviation of a position up to which it is weighed sample by sample; whose place is known worse is
left where they were until it surely lies on one side."""
AROUND = 50.0
"""Metres round a floor's outline in which zones are watched."""
FARTHEST = 1e8
"""Metres at which a corner may lie."""
MOST_ZONES = 10_000
"""Watched at most: each takes some 20 kB, and a third of a millisecond whenever zones change."""
_NEEDS_LIMIT = ("dwell", "crowd", "proximity", "speed")


@dataclass(frozen=True)
class Rule:
    """One rule of one zone, as it is watched.

    Attributes:
        key: names it among all rules of the site.
        told_as: what its alerts call it; empty for the site file's ``alert_on``.
        rule: what was asked.
        border: which it looks at.
    """

    key: str
    told_as: str
    rule: ZoneRule
    border: int

    @property
    def limit(self) -> float:
        """Of kinds that have one."""
        return self.rule.limit or 0.0

    def fits(self, device: str | None) -> bool:
        """Whether the rule is about somebody who carries ``device``, or nobody knows what."""
        rule = self.rule
        if rule.devices:
            return device in rule.devices
        return rule.audience == "everybody" or (rule.audience == "phones") == (device is not None)


@dataclass(frozen=True)
class ZonePlan:
    """All zones of a site as they are watched.

    Attributes:
        zones: by id.
        borders: their geometry.
        zone_of: of each border, its zone.
        rules_of: of each border, the rules that look at it.
        counted: border of each area at a half, by zone.
        keys: of each border, what stays the same while its shape changes.
        problems: what cannot be watched and why, by zone.
    """

    zones: Mapping[str, ZoneDefinition]
    borders: Borders
    zone_of: Sequence[ZoneDefinition]
    rules_of: Sequence[Sequence[Rule]]
    counted: Mapping[str, int]
    keys: Sequence[tuple[str, str, float]]
    problems: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        zones: Iterable[ZoneDefinition],
        site: Site,
        margin: float,
        min_seconds: float,
        *,
        named: bool = True,
    ) -> ZonePlan:
        """Return the plan of these zones; see ``Borders`` for margin and seconds.

        ``named``: alerts name the rule; not where the rules only stand for the site file's ``alert_on``.
        """
        floors = {floor.id: _around(floor.outline) for floor in site.floors}
        watched: dict[str, ZoneDefinition] = {}
        problems: dict[str, str] = {}
        borders: dict[tuple[str, str, float], ZoneDefinition] = {}
        rules: list[tuple[tuple[str, str, float], ZoneRule]] = []
        for zone in zones:
            wrong = _one_too_many(zone, watched) or _wrong_shape(zone, floors)
            if wrong:
                problems[zone.id] = f"not watched: {wrong}"
                continue
            watched[zone.id] = zone
            if zone.shape == "area":
                borders[zone.id, zone.shape, EVEN] = zone
            for rule in zone.rules:
                wrong = _wrong_rule(rule, zone)
                if wrong:
                    problems[zone.id] = f"rule {rule.id} is not watched: {wrong}"
                    continue
                asked: tuple[str, str, float] = (zone.id, zone.shape, rule.confidence)
                borders[asked] = zone
                rules.append((asked, rule))
        number = {key: place for place, key in enumerate(borders)}
        rules_of: list[list[Rule]] = [[] for _ in borders]
        for key, rule in rules:
            told_as = rule.id if named else ""
            rules_of[number[key]].append(Rule(f"{key[0]}/{rule.id}/{rule.kind}", told_as, rule, number[key]))
        listed = list(borders.values())
        index = ZoneIndex(
            [zone.points for zone in listed],
            [zone.floor for zone in listed],
            margin + SURE * MOST_SPREAD,
            [zone.shape == "line" for zone in listed],
            floors,
        )
        confidence = np.array([key[2] for key in borders])
        return cls(
            watched,
            Borders(index, margin, min_seconds, confidence),
            listed,
            rules_of,
            {key[0]: place for key, place in number.items() if key[1:] == ("area", EVEN)},
            list(borders),
            problems,
        )

    def becomes(self, other: ZonePlan) -> dict[int, int]:
        """Return which border of this plan is which of another, whatever its shape is now."""
        number = {key: place for place, key in enumerate(other.keys)}
        return {place: number[key] for place, key in enumerate(self.keys) if key in number}

    def unchanged(self, other: ZonePlan) -> set[int]:
        """Return the borders of this plan that are the same in another."""
        return {
            place
            for place, now in self.becomes(other).items()
            if (self.zone_of[place].points, self.zone_of[place].floor)
            == (other.zone_of[now].points, other.zone_of[now].floor)
        }


def of_site(zones: Iterable[Zone]) -> list[ZoneDefinition]:
    """Return the site file's zones as the API would tell them."""
    return [
        ZoneDefinition(
            id=zone.id,
            name=zone.name,
            floor=zone.floor,
            points=list(zone.polygon),
            rules=[ZoneRule(id=kind, kind=kind) for kind in dict.fromkeys(zone.alert_on)],
        )
        for zone in zones
    ]


def _around(outline: Sequence[tuple[float, float]]) -> Box:
    corners = np.array(outline, float)
    (x0, y0), (x1, y1) = corners.min(axis=0) - AROUND, corners.max(axis=0) + AROUND
    return float(x0), float(y0), float(x1), float(y1)


def _wrong_shape(zone: ZoneDefinition, floors: Mapping[str, Box]) -> str:
    """Return why a zone's shape cannot be watched; empty: it can."""
    if zone.floor not in floors:
        return f"the site has no floor {zone.floor!r}"
    if not all(math.isfinite(value) for point in zone.points for value in point):
        return "a corner is not a finite number"
    if any(abs(value) > FARTHEST for point in zone.points for value in point):
        return f"a corner is farther than {FARTHEST:.0e} m away"
    shape: shapely.LineString | shapely.Polygon
    if zone.shape == "line":
        shape = shapely.LineString(zone.points)
        if shape.length <= 0.0:
            return "the line has no length"
    elif len(zone.points) < 3:
        return "an area has three corners or more"
    else:
        shape = shapely.Polygon(zone.points)
        if not shape.is_valid:
            return f"its border crosses or touches itself ({shapely.is_valid_reason(shape)})"
        if shape.area <= 0.0:
            return "it encloses nothing"
    if not shape.intersects(shapely.box(*floors[zone.floor])):
        return f"it lies more than {AROUND:g} m outside of floor {zone.floor!r}"
    return ""


def _one_too_many(zone: ZoneDefinition, watched: Mapping[str, ZoneDefinition]) -> str:
    if zone.id in watched:
        return "there are two of this id"
    return f"there are more than {MOST_ZONES} zones" if len(watched) >= MOST_ZONES else ""


def _wrong_rule(rule: ZoneRule, zone: ZoneDefinition) -> str:
    """Return why a rule of a zone cannot be watched; empty: it can."""
    if (rule.kind == "cross") != (zone.shape == "line"):
        return f"{rule.kind} is no rule of {'a line' if zone.shape == 'line' else 'an area'}"
    if rule.kind in _NEEDS_LIMIT and rule.limit is None:
        return f"{rule.kind} needs a limit"
    return ""
