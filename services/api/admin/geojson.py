"""Zones and exhibits as GeoJSON: in metres of the plan, or in WGS 84 (RFC 7946) where the site is anchored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from fastapi import Query, Request

from services.api.request_body import invalid
from shared.site.geographic import PlanOnEarth

__all__ = [
    "CRS",
    "GEOJSON",
    "PLAN_METRES",
    "Crs",
    "Drawing",
    "collection",
    "drawing",
    "feature",
    "features_of",
    "place_of",
    "placed",
    "point",
]

GEOJSON = "application/geo+json"
Crs = Literal["plan", "wgs84"]
CRS = Query(description="of GeoJSON: plan, metres; wgs84, longitude and latitude, where the site file has an anchor")
Points = list[tuple[float, float]]

PLAN_METRES = "plan metres"
"""What a ``crs`` member calls the plan's coordinates."""
_NAMES: dict[Crs, tuple[str, ...]] = {
    "plan": (PLAN_METRES,),
    "wgs84": ("urn:ogc:def:crs:OGC:1.3:CRS84", "urn:ogc:def:crs:OGC::CRS84", "OGC:CRS84"),
}
"""What a ``crs`` member may say."""

DECIMALS = 8
"""Of degrees: a millimetre."""


@dataclass(frozen=True)
class Drawing:
    """How a read wants places told: as GeoJSON or not, and where."""

    crs: Crs
    geojson: bool


async def drawing(
    request: Request,
    crs: Annotated[Crs, CRS] = "plan",
    format: Annotated[  # noqa: A002
        Literal["json", "geojson"] | None, Query(description=f"of the answer; without it, as Accept says ({GEOJSON})")
    ] = None,
) -> Drawing:
    """Return how a read wants its places told.

    Raises:
        ProblemError: longitudes are asked for and GeoJSON is not.
    """
    geojson = format == "geojson" or (format is None and GEOJSON in request.headers.get("accept", ""))
    if crs != "plan" and not geojson:
        raise invalid("crs", crs, f"plan; wgs84 goes with format=geojson or Accept: {GEOJSON}")
    return Drawing(crs, geojson)


def placed(crs: Crs, earth: PlanOnEarth | None) -> PlanOnEarth | None:
    """Return how coordinates of ``crs`` are turned into the plan's; None: they are the plan's.

    Raises:
        ProblemError: the site's place on Earth is not known.
    """
    if crs == "plan":
        return None
    if earth is None:
        raise invalid("crs", "wgs84", "plan: the site file names no anchor, its place on Earth")
    return earth


def collection(features: Sequence[dict[str, Any]], **beside: Any) -> dict[str, Any]:
    """Return many features as one thing, and what else is told ``beside`` them."""
    return {"type": "FeatureCollection", "features": features, **beside}


def features_of(document: Any, earth: PlanOnEarth | None) -> list[dict[str, Any]]:
    """Return the features of a Feature or FeatureCollection.

    Args:
        document: what was sent.
        earth: turns its coordinates into the plan's; None: they are the plan's.

    Raises:
        ProblemError: it is neither, or says itself that its coordinates are others.
    """
    kind = document.get("type") if isinstance(document, dict) else None
    if kind == "FeatureCollection":
        features = document.get("features")
        if not isinstance(features, list) or not features:
            raise invalid("features", "nothing", "a list of GeoJSON features")
    elif kind == "Feature":
        features = [document]
    else:
        raise invalid("type", str(kind)[:64], "Feature or FeatureCollection")
    for number, feature in enumerate(features):
        if not isinstance(feature, dict) or feature.get("type") != "Feature":
            raise invalid(f"features[{number}].type", "something else", "Feature")
        if not isinstance(feature.get("properties") or {}, dict):
            raise invalid(f"features[{number}].properties", "something else", "an object")
    for part in (document, *features, *(feature.get("geometry") for feature in features)):
        if isinstance(part, dict) and part.get("crs") is not None:
            _check_crs(part["crs"], "plan" if earth is None else "wgs84")
    return features


def _check_crs(told: Any, crs: Crs) -> None:
    """Refuse a ``crs`` member (of the GeoJSON of 2008, which many programs still write) that names another system."""
    properties = told.get("properties") if isinstance(told, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    if not isinstance(name, str) or name not in _NAMES[crs]:
        found = name[:100] if isinstance(name, str) else "one without a name"
        raise invalid("crs", found, f"none, or {' or '.join(_NAMES[crs])}, as the query says: crs={crs}")


def feature(
    name: str,
    geometry: Literal["Polygon", "LineString", "Point"],
    points: Points,
    properties: dict[str, Any],
    earth: PlanOnEarth | None,
) -> dict[str, Any]:
    """Return one feature; of a polygon ``points`` are its corners, each once."""
    coordinates: Any = points if earth is None else np.round(earth.to_wgs84(np.array(points)), DECIMALS).tolist()
    if geometry == "Polygon":
        coordinates = [[*coordinates, coordinates[0]]]
    elif geometry == "Point":
        coordinates = coordinates[0]
    return {
        "type": "Feature",
        "id": name,
        "geometry": {"type": geometry, "coordinates": coordinates},
        "properties": properties,
    }


def point(name: str, told: msgspec.Struct, earth: PlanOnEarth | None) -> dict[str, Any]:
    """Return something that has a place, ``x`` and ``y``, as a Point; all else that is told of it: its properties."""
    properties = msgspec.to_builtins(told)
    properties.pop("id", None)
    return feature(name, "Point", [(properties.pop("x"), properties.pop("y"))], properties, earth)


def place_of(
    feature: dict[str, Any], allowed: Sequence[str], earth: PlanOnEarth | None
) -> tuple[str, Points, dict[str, Any]]:
    """Return the kind of geometry, its points in metres of the plan, and the properties, ``id`` among them.

    Raises:
        ProblemError: another kind of geometry, holes, or coordinates that are none or far off.
    """
    geometry = feature.get("geometry")
    kind = str(geometry.get("type")) if isinstance(geometry, dict) else "nothing"
    if not isinstance(geometry, dict) or kind not in allowed:
        raise invalid("geometry.type", kind[:64], " or ".join(allowed))
    coordinates = geometry.get("coordinates")
    if kind == "Polygon":
        if not isinstance(coordinates, list) or len(coordinates) != 1:
            raise invalid("geometry.coordinates", "holes, or nothing", "one ring: zones have no holes")
        coordinates = coordinates[0]
    points = _points([coordinates] if kind == "Point" else coordinates)
    if kind == "Polygon" and len(points) > 1 and points[0] == points[-1]:
        points = points[:-1]
    if earth is not None:
        try:
            points = [(x, y) for x, y in np.round(earth.to_plan(np.array(points)), 4).tolist()]
        except ValueError as reason:
            raise invalid("geometry.coordinates", str(reason), "longitude, latitude near the site") from reason
    properties = dict(feature.get("properties") or {})
    if "id" in feature:
        properties.setdefault("id", feature["id"])
    return kind, points, properties


def _points(coordinates: Any) -> Points:
    try:
        # A third number is a height, which RFC 7946 allows and zones do not have.
        pairs = msgspec.convert([list(pair)[:2] for pair in coordinates], list[tuple[float, float]])
    except (msgspec.ValidationError, TypeError) as reason:
        raise invalid("geometry.coordinates", str(reason)[:100], "pairs of finite numbers") from reason
    if not pairs:
        raise invalid("geometry.coordinates", "nothing", "pairs of finite numbers")
    return pairs
