"""Can anybody be in this zone, and can its rules ever be told? Refused are shapes and rules that mean nothing."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import shapely

from services.api.request_body import invalid
from shared.zones import ZoneDefinition, ZoneRule

__all__ = ["MOST_POINTS", "MOST_ZONES", "check_all", "check_floor", "check_zone"]

MOST_ZONES = 2000
MOST_POINTS = 100_000
"""Of all zones together: everybody who reads the zones is sent them."""
FARTHEST = 10_000.0
"""Metres from the plan's zero."""
SMALLEST = 0.01
"""Square metres of an area, metres of a line."""
NEED_LIMIT = {"dwell": "seconds", "crowd": "people", "proximity": "metres", "speed": "m/s"}


def check_zone(zone: ZoneDefinition, floors: Mapping[str, shapely.Polygon]) -> None:
    """Accept a zone.

    Args:
        zone: as a client drew it.
        floors: the outline of each floor by its id.

    Raises:
        ProblemError: the floor is not known, the shape is self-crossing, empty, huge or off the floor, or a rule does
            not fit.
    """
    outline = check_floor(zone.floor, floors)
    if not all(math.isfinite(value) and abs(value) <= FARTHEST for point in zone.points for value in point):
        raise invalid("points", "a place far off", f"metres on the plan, at most {FARTHEST:g} from its zero")
    shape = _area(zone.points) if zone.shape == "area" else _line(zone.points)
    if not shape.intersects(outline):
        raise invalid("points", "a shape that lies nowhere on the floor", f"a part of floor {zone.floor}")
    names = [rule.id for rule in zone.rules]
    for number, rule in enumerate(zone.rules):
        if names.index(rule.id) != number:
            raise invalid(f"rules[{number}].id", f"{rule.id} twice", "ids that differ within a zone")
        _check_rule(rule, zone.shape == "line", f"rules[{number}]")


def check_all(before: Iterable[ZoneDefinition], after: Iterable[ZoneDefinition]) -> None:
    """Accept a change of all zones; what is fewer than before is accepted, however much is left.

    Raises:
        ProblemError: they would have too many points.
    """
    points = sum(len(zone.points) for zone in after)
    if points > MOST_POINTS and points > sum(len(zone.points) for zone in before):
        raise invalid("points", f"{points} in all zones together", f"at most {MOST_POINTS} in all zones together")


def check_floor(floor: str, floors: Mapping[str, shapely.Polygon]) -> shapely.Polygon:
    """Return the outline of a floor.

    Raises:
        ProblemError: the site has no such floor.
    """
    if floor not in floors:
        raise invalid("floor", floor, ", ".join(floors))
    return floors[floor]


def _area(points: list[tuple[float, float]]) -> shapely.Polygon:
    if len(set(points)) < 3:
        raise invalid("points", f"{len(set(points))} corners", 'an area with at least 3 corners, or "shape": "line"')
    polygon = shapely.Polygon(points)
    if not polygon.is_valid:
        reason = shapely.is_valid_reason(polygon)
        raise invalid("points", f"a shape that crosses or touches itself ({reason})", "an outline that does not")
    if polygon.area < SMALLEST:
        raise invalid("points", f"an area of {polygon.area:.2g} m²", f"at least {SMALLEST:g} m²")
    return polygon


def _line(points: list[tuple[float, float]]) -> shapely.LineString:
    line = shapely.LineString(points)
    if line.length < SMALLEST:
        raise invalid("points", f"a line of {line.length:.2g} m", f"at least {SMALLEST:g} m")
    if not line.is_simple:
        raise invalid("points", "a line that crosses itself", "one that does not")
    return line


def _check_rule(rule: ZoneRule, of_line: bool, field: str) -> None:
    if of_line != (rule.kind == "cross"):
        allowed = "cross, for a line" if of_line else "enter, exit, dwell, crowd, proximity or speed, for an area"
        other = "area" if of_line else "line"
        raise invalid(f"{field}.kind", rule.kind, f'{allowed}; or with "shape": "{other}"')
    unit = NEED_LIMIT.get(rule.kind)
    if unit is None and rule.limit is not None:
        raise invalid(f"{field}.limit", f"{rule.limit:g}", f"none: {rule.kind} has no limit")
    if unit is not None and (rule.limit is None or not math.isfinite(rule.limit)):
        raise invalid(f"{field}.limit", str(rule.limit), f"{unit}, a number above 0")
    if rule.direction != "both" and rule.kind != "cross":
        raise invalid(f"{field}.direction", rule.direction, f"both: only cross has a direction, not {rule.kind}")
    if rule.target and rule.kind != "proximity":
        raise invalid(f"{field}.target", rule.target, f"none: only proximity has a target, not {rule.kind}")
