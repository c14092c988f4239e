"""The past in the formats other programs read: GeoJSON, CSV, Parquet."""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
import pyarrow
import pyarrow.parquet
from starlette.responses import Response

from services.api.admin.geojson import PLAN_METRES
from shared.site.geographic import PlanOnEarth

__all__ = ["csv_answer", "geojson_answer", "parquet_answer"]

CSV, PARQUET, GEOJSON = "text/csv; charset=utf-8", "application/vnd.apache.parquet", "application/geo+json"
_RISKY = ("=", "+", "-", "@", "\t", "\r")
"""A cell of text that begins so is a formula to a spreadsheet."""


def csv_answer(columns: Mapping[str, Sequence[Any]], name: str) -> Response:
    """Return a table as comma-separated values with a header; empty where nothing is known."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\r\n")
    writer.writerow(columns)
    writer.writerows(zip(*(_harmless(values) for values in columns.values()), strict=True))
    return Response(out.getvalue(), media_type=CSV, headers=_saved_as(f"{name}.csv"))


def parquet_answer(columns: Mapping[str, Sequence[Any]], name: str, said: Mapping[str, str]) -> Response:
    """Return a table as a Parquet file that says ``said`` of itself."""
    table = pyarrow.table({column: pyarrow.array(values) for column, values in columns.items()})
    out = io.BytesIO()
    pyarrow.parquet.write_table(table.replace_schema_metadata(dict(said)), out, compression="zstd")
    return Response(out.getvalue(), media_type=PARQUET, headers=_saved_as(f"{name}.parquet"))


def geojson_answer(columns: Mapping[str, Sequence[Any]], device: str, earth: PlanOnEarth | None) -> Response:
    """Return a way as GeoJSON: a LineString per stay on one floor, its times beside it.

    Args:
        columns: t, floor, x, y, accuracy; parallel.
        device: whose.
        earth: where the plan lies; None: coordinates are metres of the plan, and ``crs`` says so.
    """
    floor = list(columns["floor"])
    where = np.column_stack([np.asarray(columns["x"], float), np.asarray(columns["y"], float)])
    placed = np.round(where if earth is None else earth.to_wgs84(where), 3 if earth is None else 8).tolist()
    cuts = [0, *(row for row in range(1, len(floor)) if floor[row] != floor[row - 1]), len(floor)]
    features = []
    for begin, end in itertools.pairwise(cuts):
        if begin == end:
            continue
        line = placed[begin:end]
        geometry = {"type": "LineString", "coordinates": line} if len(line) > 1 else _point(line[0])
        properties = {
            "device": device,
            "floor": floor[begin],
            "t": list(columns["t"][begin:end]),
            "accuracy": list(columns["accuracy"][begin:end]),
        }
        features.append({"type": "Feature", "geometry": geometry, "properties": properties})
    body: dict[str, Any] = {"type": "FeatureCollection", "features": features}
    if earth is None:
        body["crs"] = {"type": "name", "properties": {"name": PLAN_METRES}}
    return Response(msgspec.json.encode(body), media_type=GEOJSON)


def _point(place: Sequence[float]) -> dict[str, Any]:
    return {"type": "Point", "coordinates": place}


def _harmless(values: Sequence[Any]) -> Sequence[Any]:
    return [f"'{value}" if isinstance(value, str) and value.startswith(_RISKY) else value for value in values]


def _saved_as(name: str) -> dict[str, str]:
    return {"Content-Disposition": f'attachment; filename="{name}"'}
