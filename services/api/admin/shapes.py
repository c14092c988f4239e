"""Definitions and what clients send of them: JSON as answered, or GeoJSON."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import msgspec
import shapely

from services.api.admin.exhibits import MOST_EXHIBITS, ExhibitDefinition, check_exhibit
from services.api.admin.geojson import feature, features_of, place_of, point
from services.api.admin.zone_check import MOST_ZONES, check_zone
from services.api.nameless import unnamed_rules
from services.api.request_body import invalid, only_known, read_json
from shared.site.geographic import PlanOnEarth
from shared.zones import ZoneDefinition

__all__ = ["EXHIBIT", "ZONE", "Kind"]

D = TypeVar("D", ZoneDefinition, ExhibitDefinition)
Feature = dict[str, Any]
Floors = Mapping[str, shapely.Polygon]


@dataclass(frozen=True)
class Kind(Generic[D]):
    """How definitions of one kind are read, checked and drawn."""

    name: str
    shape: type[D]
    allowed: str
    answered: frozenset[str]
    """Fields that answers have beside a definition's; a request may send them back."""
    draw: Callable[[D, PlanOnEarth | None], Feature]
    undraw: Callable[[Feature, PlanOnEarth | None], dict[str, Any]]
    check: Callable[[D, Floors], None]
    complete: Callable[[dict[str, Any]], dict[str, Any]] = lambda told: told
    """Fills in what a request may leave out because the rest tells it."""
    unnamed: Callable[[Any], Any] = lambda told: told
    """Leaves out which phones a definition, or an answer, names."""
    most: int = MOST_ZONES
    """As many may come at once."""

    def read(
        self, body: bytes, floors: Floors, *, geojson: bool, earth: PlanOnEarth | None, path_id: str | None = None
    ) -> list[D]:
        """Return the definitions that a body holds, checked.

        Args:
            body: what was sent.
            floors: the outline of each floor by its id.
            geojson: whether it is GeoJSON.
            earth: turns its coordinates into the plan's, if need be.
            path_id: which one is meant, where the path says so: it must be one, of that id.

        Raises:
            ProblemError: something does not fit; nothing of it is to be taken.
        """
        told = read_json(body, self.allowed)
        many = told.get("features") if geojson and isinstance(told, dict) else None
        if isinstance(many, list) and len(many) > self.most:
            raise invalid("features", f"{len(many)}", f"at most {self.most} at once")
        parts = [self.undraw(one, earth) for one in features_of(told, earth)] if geojson else [told]
        if path_id is not None and len(parts) != 1:
            raise invalid("features", f"{len(parts)}", "one")
        definitions = []
        for part in parts:
            if not isinstance(part, dict):
                raise invalid("body", f"a {type(part).__name__}", self.allowed)
            known = {name: value for name, value in part.items() if name not in self.answered}
            if path_id is not None and known.setdefault("id", path_id) != path_id:
                raise invalid("id", str(known["id"])[:64], f"{path_id}, as in the path")
            definition = only_known(self.complete(known), self.shape, self.allowed)
            self.check(definition, floors)
            definitions.append(definition)
        return definitions


def _complete_zone(told: dict[str, Any]) -> dict[str, Any]:
    """Two points are a line, more an area; rules are called what they tell, numbered where one kind comes twice."""
    points, rules = told.get("points"), told.get("rules")
    if isinstance(points, list) and len(points) > 2:
        once = [here for before, here in itertools.pairwise([None, *points]) if here != before]
        told = told | {"points": once[:-1] if len(once) > 3 and once[0] == once[-1] else once}
        points = told["points"]
    if "shape" not in told and isinstance(points, list) and len(points) == 2:
        told = told | {"shape": "line"}
    if not isinstance(rules, list) or not all(isinstance(rule, dict) for rule in rules):
        return told
    taken = {rule["id"] for rule in rules if isinstance(rule.get("id"), str)}
    named = []
    for rule in rules:
        kind = rule.get("kind")
        if "id" not in rule and isinstance(kind, str):
            numbered = (kind if number == 1 else f"{kind}-{number}" for number in itertools.count(1))
            rule = {"id": next(name for name in numbered if name not in taken)} | rule
            taken.add(rule["id"])
        named.append(rule)
    return told | {"rules": named}


def _draw_zone(zone: ZoneDefinition, earth: PlanOnEarth | None) -> Feature:
    rules = [msgspec.to_builtins(rule) for rule in zone.rules]
    geometry: Any = "Polygon" if zone.shape == "area" else "LineString"
    return feature(zone.id, geometry, zone.points, {"name": zone.name, "floor": zone.floor, "rules": rules}, earth)


def _undraw_zone(drawn: Feature, earth: PlanOnEarth | None) -> dict[str, Any]:
    kind, points, properties = place_of(drawn, ("Polygon", "LineString"), earth)
    return {**properties, "shape": "area" if kind == "Polygon" else "line", "points": points}


def _draw_exhibit(exhibit: ExhibitDefinition, earth: PlanOnEarth | None) -> Feature:
    return point(exhibit.id, exhibit, earth)


def _undraw_exhibit(drawn: Feature, earth: PlanOnEarth | None) -> dict[str, Any]:
    _, points, properties = place_of(drawn, ("Point",), earth)
    return {**properties, "x": points[0][0], "y": points[0][1]}


ZONE = Kind(
    "zone",
    ZoneDefinition,
    "a zone: id, floor, points, and name, shape, rules if wanted",
    frozenset({"inside", "unseen", "blind", "etag", "polygon", "alert_on"}),
    _draw_zone,
    _undraw_zone,
    check_zone,
    _complete_zone,
    unnamed_rules,
)
EXHIBIT = Kind(
    "exhibit",
    ExhibitDefinition,
    "an exhibit: id, floor, x, y, and name, reach, facing if wanted",
    frozenset({"etag"}),
    _draw_exhibit,
    _undraw_exhibit,
    check_exhibit,
    most=MOST_EXHIBITS,
)
