"""Filters, pages and tags of the reads: as one by one, none twice, none missed."""

import math
import re
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
from api_app import Api, api, hall
from fastapi import FastAPI, Query
from fastapi.testclient import TestClient
from hypothesis import given
from hypothesis import strategies as st
from starlette.testclient import WebSocketDenialResponse
from waiting import wait_until

from services.api.admin.geojson import GEOJSON
from services.api.place_filter import Place
from services.api.row_filters import Wanted, select
from services.api.times import Time
from services.api.zones_drawn import ZonesDrawn, zones_of
from shared.site.geographic import PlanOnEarth

PEOPLE = [("a", 10.0, 1.0), ("b", 10.0, 7.0), (None, 11.0, 1.0), ("c", 2.0, 11.0), (None, 3.0, 11.0)]
ZONES = ZonesDrawn(zones_of(hall()))
QUALITY = [0.9, 0.5, 0.9, 0.2, 0.95]


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Any:
    with api(tmp_path_factory.mktemp("api")) as made:
        made.people(*PEOPLE, quality=QUALITY, probability=[0.99, 0.6, 0.9, 0.8, 0.9])
        yield made


def devices(here: Api, query: str) -> list[str]:
    return [row["device"] for row in here.client.get(f"/v1/positions?{query}").json()["positions"]]


def tracks(here: Api, query: str) -> list[int]:
    return [row["track"] for row in here.client.get(f"/v1/tracks?{query}").json()["tracks"]]


@pytest.mark.parametrize(
    ("query", "named", "everybody"),
    [
        ("floor=ground", ["a", "b", "c"], [1, 2, 3, 4, 5]),
        ("zone=entrance", ["a"], [1, 3]),
        ("near=10,1,1.5", ["a"], [1, 3]),
        ("near=10,1,0.5&floor=ground", ["a"], [1]),
        ("confidence=0.8", ["a", "c"], [1, 3, 5]),
        ("confidence=0.8&zone=model-corner", [], []),
        ("age=60", ["a", "b", "c"], [1, 2, 3, 4, 5]),
        ("age=0", [], []),
        ("limit=2", ["a", "b"], [1, 2]),
        ("limit=2&cursor=a", ["b", "c"], [1, 2]),
    ],
)
def test_filters_keep_what_matches(here: Api, query: str, named: list[str], everybody: list[int]) -> None:
    here.people(*PEOPLE, quality=QUALITY, probability=[0.99, 0.6, 0.9, 0.8, 0.9])
    wait_until(lambda: here.live.positions(time.time())[0].age > 0.0, 20.0, "a moment to pass")
    assert devices(here, query) == named
    if "cursor" not in query:
        assert tracks(here, query) == everybody


def test_pages_hold_everybody_once(here: Api) -> None:
    for path, key in (("positions", "device"), ("tracks", "track"), ("devices", "device")):
        everybody = [row[key] for row in here.client.get(f"/v1/{path}?limit=1000").json()[path]]
        seen, query = [], "limit=2"
        while True:
            page = here.client.get(f"/v1/{path}?{query}").json()
            seen += [row[key] for row in page[path]]
            assert len(page[path]) <= 2
            if page["next"] is None:
                break
            query = f"limit=2&cursor={page['next']}"
        assert seen == everybody
        assert len(seen) >= 3


def test_devices_are_told_with_their_zones(here: Api) -> None:
    told = here.client.get("/v1/devices").json()["devices"]
    assert [(row["device"], row["zones"], row["state"]) for row in told] == [
        ("a", ["entrance"], "confirmed"),
        ("b", ["model-corner"], "confirmed"),
        ("c", [], "confirmed"),
    ]


@pytest.mark.parametrize(
    ("query", "status", "field"),
    [
        ("age=-1", 422, "age"),
        ("age=nan", 422, "age"),
        ("confidence=2", 422, "confidence"),
        ("near=1,2", 422, "near"),
        ("near=1,2,inf", 422, "near"),
        ("near=1,2,-1", 422, "near"),
        ("near=a,b,c", 422, "near"),
        ("limit=0", 422, "limit"),
        ("zone=nowhere", 404, "zone"),
        ("zone=%00", 404, "zone"),
        ("floor=roof", 404, "floor"),
    ],
)
def test_filters_that_make_no_sense_are_refused_by_name(here: Api, query: str, status: int, field: str) -> None:
    for path in ("positions", "tracks", "devices"):
        reply = here.client.get(f"/v1/{path}?{query}")
        assert (reply.status_code, reply.json()["field"]) == (status, field)
        assert reply.json()["found"]


def test_near_needs_a_floor_where_there_are_several(tmp_path: Path) -> None:
    site = hall()
    upper = site.floors[0].model_copy(update={"id": "upper", "level": 1})
    with api(tmp_path, site.model_copy(update={"floors": [*site.floors, upper]})) as here:
        here.people(("a", 10.0, 1.0))
        reply = here.client.get("/v1/positions?near=10,1,2")
        assert (reply.status_code, reply.json()["field"]) == (422, "floor")
        assert devices(here, "near=10,1,2&floor=ground") == ["a"]
        assert devices(here, "near=10,1,2&floor=upper") == []


class Row:
    def __init__(self, name: int, x: float, y: float, age: float, sure: float) -> None:
        self.name, self.x, self.y, self.age, self.sure = f"d{name:03d}", x, y, age, sure
        self.floor = "ground"


rows = st.lists(
    st.builds(Row, st.integers(0, 999), st.floats(-5, 25), st.floats(-5, 15), st.floats(0, 60), st.floats(0, 1)),
    max_size=30,
    unique_by=lambda row: row.name,
)


@given(rows, st.floats(0, 60), st.floats(0, 1), st.floats(0.1, 20), st.integers(1, 10))
def test_as_one_by_one(people: list[Row], age: float, sure: float, radius: float, limit: int) -> None:
    near = (10.0, 6.0, radius)
    seen: list[str] = []
    cursor = None
    while True:
        asked = Wanted(age, sure, Place(None, near, "ground"), limit, cursor)
        page, cursor = select(people, asked, ZONES, ["ground"], lambda row: row.name, lambda row: row.sure)
        seen += [row.name for row in page]
        if cursor is None:
            break
    assert seen == sorted(
        row.name
        for row in people
        if row.age <= age and row.sure >= sure and math.hypot(row.x - 10.0, row.y - 6.0) <= radius
    )


def test_a_read_that_did_not_change_is_not_sent_again(here: Api) -> None:
    site = here.client.get("/v1/site")
    again = here.client.get("/v1/site", headers={"If-None-Match": f'"other", W/{site.headers["ETag"]}'})
    assert (again.status_code, again.content, again.headers["ETag"]) == (304, b"", site.headers["ETag"])
    here.client.post("/v1/zones", json={"id": "new", "floor": "ground", "points": [[0, 0], [1, 0], [1, 1]]})
    changed = here.client.get("/v1/site", headers={"If-None-Match": site.headers["ETag"]})
    assert (changed.status_code, changed.headers["ETag"] != site.headers["ETag"]) == (200, True)
    none = here.client.get("/v1/exhibits")
    held = {"If-None-Match": none.headers["ETag"]}
    assert here.client.get("/v1/exhibits", headers=held).status_code == 304
    here.client.post("/v1/exhibits", json={"id": "bust", "floor": "ground", "x": 5.0, "y": 4.0})
    assert "bust" in [one["id"] for one in here.client.get("/v1/exhibits", headers=held).json()["exhibits"]]
    first = here.client.get("/v1/positions")
    here.people(*PEOPLE)
    second = here.client.get("/v1/positions", headers={"If-None-Match": first.headers["ETag"]})
    assert second.status_code == 200
    assert here.client.get("/v1/positions", headers={"If-None-Match": "*x"}).status_code == 200


def test_what_one_origin_is_told_no_other_request_gets(tmp_path: Path) -> None:
    with api(tmp_path, cors_origins=["https://map.example.org"]) as here:
        page = here.client.get("/v1/site", headers={"Origin": "https://map.example.org"})
        assert page.headers["Access-Control-Allow-Origin"] == "https://map.example.org"
        again = here.client.get("/v1/site")
        assert again.headers["ETag"] == page.headers["ETag"]
        assert "Access-Control-Allow-Origin" not in again.headers
        asked = {"Origin": "https://map.example.org", "Access-Control-Request-Method": "PUT", "Authorization": ""}
        allowed = here.client.options("/v1/zones/a", headers=asked | {"Access-Control-Request-Headers": "if-match"})
        assert allowed.status_code == 200


def test_no_route_passes_over_a_parameter_it_does_not_know(here: Api) -> None:
    paths = here.client.get("/openapi.json").json()["paths"]
    for path, operations in paths.items():
        for method in operations:
            told = here.client.request(method, re.sub(r"{\w+}", "hall", path), params={"zones": "entrance"})
            assert (told.status_code, told.json()["field"]) == (422, "zones"), (method, path)
    told = here.client.get("/v1/alerts?kind=cross").json()
    assert "kinds" in told["allowed"]
    with (
        pytest.raises(WebSocketDenialResponse) as refused,
        here.client.websocket_connect("/v1/ws?kind=alert"),
    ):
        pass
    assert refused.value.status_code == 422


def test_what_takes_one_value_is_not_given_two(here: Api) -> None:
    paths = here.client.get("/openapi.json").json()["paths"]
    lists = []
    for path, operations in paths.items():
        for method, operation in operations.items():
            for query in (one for one in operation.get("parameters", []) if one["in"] == "query"):
                twice = [(query["name"], "1"), (query["name"], "2")]
                told = here.client.request(method, re.sub(r"{\w+}", "hall", path), params=twice)
                refused = told.status_code == 422 and told.json()["detail"].endswith(
                    "more than once; allowed: one value"
                )
                assert refused != ("array" in str(query["schema"])), (method, path, query["name"])
                lists += [query["name"]] * (not refused)
    assert set(lists) == {"zone", "area", "camera"}


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("1767225600.5", 1767225600.5),
        ("2026-01-01T00:00:00Z", 1767225600.0),
        ("2026-01-01T01:00:00.25%2B01:00", 1767225600.25),
        ("2026-01-01T01:00:00+01:00", 1767225600.0),
        ("2025-12-31 19:00:00-05:00", 1767225600.0),
        ("2026-01-01T00:00:00", None),
        ("2026-13-01T00:00:00Z", None),
        ("0001-01-01T00:00:00%2B14:00", -62135647200.0),
        ("2026-01-01", None),
        ("nan", None),
        ("yesterday", None),
    ],
)
def test_times_are_seconds_or_rfc_3339(text: str, seconds: float | None) -> None:
    app = FastAPI()

    @app.get("/")
    def told(since: Annotated[Time | None, Query()] = None) -> float | None:
        return since

    answer = TestClient(app).get(f"/?since={text}")
    assert answer.json() == seconds if seconds is not None else answer.status_code == 422


@pytest.mark.parametrize(("path", "name"), [("positions", "device"), ("tracks", "track")])
def test_people_come_as_geojson_on_plan_or_earth(here: Api, path: str, name: str) -> None:
    here.people(*PEOPLE)
    rows = here.client.get(f"/v1/{path}?limit=1000").json()[path]
    plan = here.client.get(f"/v1/{path}", headers={"Accept": GEOJSON})
    assert plan.headers["Content-Type"] == GEOJSON
    assert [point["geometry"]["coordinates"] for point in plan.json()["features"]] == [[r["x"], r["y"]] for r in rows]
    told = here.client.get(f"/v1/{path}?format=geojson&crs=wgs84&limit=2").json()
    assert told["next"] == here.client.get(f"/v1/{path}?limit=2").json()["next"] is not None
    earth = PlanOnEarth.of(hall())
    assert earth is not None
    for point, row in zip(told["features"], rows, strict=False):
        (place,) = earth.to_plan(np.array([point["geometry"]["coordinates"]]))
        assert place.tolist() == pytest.approx([row["x"], row["y"]], abs=0.002)
        assert point["properties"][name] == row[name]
        assert point["properties"]["accuracy"] == row["accuracy"] == 0.1
    assert here.client.get(f"/v1/{path}?crs=wgs84").json()["field"] == "crs"


def test_one_device_comes_as_a_feature_and_zones_as_asked_by_format(here: Api) -> None:
    here.people(*PEOPLE)
    one = here.client.get("/v1/positions/a?format=geojson").json()
    assert (one["type"], one["id"], one["geometry"]["coordinates"]) == ("Feature", "a", [10.0, 1.0])
    assert here.client.get("/v1/zones?format=geojson").json()["type"] == "FeatureCollection"
    as_json = here.client.get("/v1/zones?format=json", headers={"Accept": GEOJSON})
    assert as_json.headers["Content-Type"] == "application/json"


def test_wgs84_of_people_is_refused_where_nobody_knows_where_the_site_is(tmp_path: Path) -> None:
    with api(tmp_path, hall(anchor=None)) as nowhere:
        told = nowhere.client.get("/v1/positions?format=geojson&crs=wgs84")
        assert (told.status_code, told.json()["field"]) == (422, "crs")
