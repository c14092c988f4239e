"""Zones and exhibits as staff edit them: kept, told of, counted in; what means nothing is refused."""

import json
import math
import time
from pathlib import Path
from typing import Any

import httpx
import msgspec
import numpy as np
import pytest
import shapely
from api_app import Api, api, hall
from hypothesis import given
from hypothesis import strategies as st

from services.api.admin.catalogue import Catalogue
from services.api.admin.database import migrate, open_admin
from services.api.admin.geojson import GEOJSON
from services.api.admin.shapes import ZONE
from services.api.problems import ProblemError
from services.api.replies import ZoneReport
from services.api.zones_drawn import People, ZonesDrawn
from shared.site.geographic import PlanOnEarth
from shared.site.site_file import Anchor
from shared.zones import ZoneDefinition

VAULT: dict[str, Any] = {"id": "vault", "floor": "ground", "points": [[1.0, 6.0], [4.0, 6.0], [4.0, 9.0], [1.0, 9.0]]}
LINE: dict[str, Any] = {
    "id": "door",
    "floor": "ground",
    "shape": "line",
    "points": [[8.0, 2.0], [12.0, 2.0]],
    "rules": [{"id": "in", "kind": "cross", "direction": "forward"}],
}
AS_GEOJSON = {"Content-Type": GEOJSON, "Accept": GEOJSON}
FLOORS = {"ground": shapely.box(0.0, 0.0, 20.0, 12.0)}


def names(api: Api) -> list[str]:
    return [zone["id"] for zone in api.client.get("/v1/zones").json()["zones"]]


def test_a_site_begins_with_its_files_zones_and_counts_in_what_is_drawn(tmp_path: Path) -> None:
    with api(tmp_path) as here:
        here.people(("phone-1", 2.0, 7.0), (None, 3.0, 8.0), (None, 10.0, 1.0))
        entrance = here.client.get("/v1/zones").json()["zones"][0]
        assert (entrance["id"], entrance["inside"], entrance["alert_on"]) == ("entrance", 1, ["enter", "exit"])
        assert here.published.sets == []
        made = here.client.post("/v1/zones", json=VAULT)
        assert (made.status_code, made.headers["Location"]) == (201, "/v1/zones/vault")
        assert (made.json()["inside"], made.json()["etag"]) == (2, made.headers["ETag"])
        assert here.client.post("/v1/zones", json=LINE).json()["inside"] == 0
        assert names(here) == ["entrance", "model-corner", "vault", "door"]
        assert [zone["id"] for zone in here.client.get("/v1/site").json()["zones"]] == names(here)
        assert [zone.id for zone in here.published.sets[-1].zones] == names(here)
        assert here.client.get("/v1/alerts?zone=vault").status_code == 200
    with api(tmp_path, hall(zones=[])) as later:
        assert names(later) == ["entrance", "model-corner", "vault", "door"], "the site file no longer counts"
        assert [len(told.zones) for told in later.published.sets] == [4], "who listens is told at the start"
        assert later.published.sets[0].version == here.published.sets[-1].version


def test_versions_grow_with_every_change_also_over_a_lost_database(tmp_path: Path) -> None:
    with api(tmp_path) as here:
        for number in range(3):
            here.client.post("/v1/zones", json=VAULT | {"id": f"z{number}"})
    (tmp_path / "again").mkdir()
    with api(tmp_path / "again") as again:
        again.client.delete("/v1/zones/entrance")
    versions = [told.version for told in here.published.sets]
    assert versions == sorted(set(versions))
    assert again.published.sets[0].version > 1_600_000_000


def test_of_two_who_change_the_same_the_later_is_told_and_nothing_is_lost(tmp_path: Path) -> None:
    with api(tmp_path) as here:
        first = here.client.get("/v1/zones/entrance")
        seen = {"If-Match": first.headers["ETag"]}
        mine = first.json() | {"name": "Mine"}
        assert here.client.put("/v1/zones/entrance", json=mine, headers=seen).status_code == 200
        late = here.client.put("/v1/zones/entrance", json=first.json() | {"name": "Other"}, headers=seen)
        assert (late.status_code, late.json()["field"], late.headers["ETag"] != seen["If-Match"]) == (
            412,
            "If-Match",
            True,
        )
        assert here.client.delete("/v1/zones/entrance", headers=seen).status_code == 412
        assert here.client.get("/v1/zones/entrance").json()["name"] == "Mine"
        assert here.client.delete("/v1/zones/entrance", headers={"If-Match": late.headers["ETag"]}).status_code == 204
        assert here.client.get("/v1/zones/entrance").status_code == 404
        assert here.client.put("/v1/zones/entrance", json=mine).status_code == 404


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"points": [[1.0, 1.0], [4.0, 4.0], [4.0, 1.0], [1.0, 4.0]]}, "points"),
        ({"points": [[1.0, 1.0], [1.0, 1.0], [1.0, 1.0]]}, "points"),
        ({"points": [[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]]}, "points"),
        ({"points": []}, "points"),
        ({"points": [[0.0, 0.0]] * 1001}, "points"),
        ({"points": [[-1e9, -1e9], [1e9, -1e9], [0.0, 1e9]]}, "points"),
        ({"points": [[100.0, 100.0], [101.0, 100.0], [101.0, 101.0]]}, "points"),
        ({"points": [["a", 1.0], [2.0, 2.0], [3.0, 1.0]]}, "points[0][0]"),
        ({"points": [[10**400, 1.0], [2.0, 2.0], [3.0, 1.0]]}, "points"),
        ({"floor": "cellar"}, "floor"),
        ({"id": "a b"}, "id"),
        ({"id": "../../etc"}, "id"),
        ({"id": 7}, "id"),
        ({"name": "x" * 201}, "name"),
        ({"name": "\x00"}, "name"),
        ({"shape": "circle"}, "shape"),
        ({"colour": "red"}, "colour"),
        ({"rules": [{"id": "r", "kind": "dwell"}]}, "rules[0].limit"),
        ({"rules": [{"id": "r", "kind": "dwell", "limit": -1.0}]}, "rules[0].limit"),
        ({"rules": [{"id": "r", "kind": "enter", "limit": 1.0}]}, "rules[0].limit"),
        ({"rules": [{"id": "r", "kind": "cross"}]}, "rules[0].kind"),
        ({"rules": [{"id": "r", "kind": "enter"}, {"id": "r", "kind": "exit"}]}, "rules[1].id"),
        ({"rules": [{"id": "r", "kind": "enter", "direction": "forward"}]}, "rules[0].direction"),
        ({"rules": [{"id": "r", "kind": "enter", "target": "forklift"}]}, "rules[0].target"),
        ({"rules": [{"id": "r", "kind": "enter", "schedule": {"since": "25:00"}}]}, "rules[0].schedule.since"),
        ({"shape": "line", "rules": [{"id": "r", "kind": "enter"}]}, "rules[0].kind"),
        ({"shape": "line", "points": [[1.0, 1.0], [1.0, 1.0]]}, "points"),
        ({"shape": "line", "points": [[1.0, 1.0], [5.0, 5.0], [5.0, 1.0], [1.0, 5.0]]}, "points"),
    ],
)
def test_a_zone_that_means_nothing_is_refused_by_field(changes: dict[str, Any], field: str) -> None:
    with pytest.raises(ProblemError) as caught:
        ZONE.read(json.dumps(VAULT | changes).encode(), FLOORS, geojson=False, earth=None)
    problem = caught.value.problem
    assert problem.status == 422
    assert problem.field is not None
    assert problem.field.startswith(field) or (field == "points" and "points" in problem.field)
    assert problem.found
    assert problem.allowed


NO_ZONES = [b"", b"[", b"7", b"null", b"[]", b'"\xff"', b"[" * 100_000, b'{"id": "a"', b"{}", b'{"id": "\\ud800"}']


def test_what_is_no_zone_at_all_is_refused(tmp_path: Path) -> None:
    with api(tmp_path) as here:
        for body in NO_ZONES:
            for headers in ({}, AS_GEOJSON):
                reply = here.client.post("/v1/zones", content=body, headers=headers)
                assert reply.status_code == 422
                assert reply.json()["field"]
        assert len(names(here)) == 2
        assert here.published.sets == []


def test_sql_and_script_are_text_like_any_other(tmp_path: Path) -> None:
    text = "'; DROP TABLE api_definitions; -- <script>alert(1)</script>"
    with api(tmp_path) as here:
        assert here.client.post("/v1/zones", json=VAULT | {"name": text}).json()["name"] == text
        assert here.client.get(f"/v1/zones/{text}").status_code == 404
    with api(tmp_path) as later:
        reply = later.client.get("/v1/zones/vault")
        assert reply.json()["name"] == text
        assert reply.headers["Content-Type"] == "application/json"


def test_a_hundred_thousand_zones_are_refused_as_a_whole(tmp_path: Path) -> None:
    def square(number: int) -> dict[str, Any]:
        ring = [[0, 0], [1, 0], [1, 1], [0, 0]]
        geometry = {"type": "Polygon", "coordinates": [ring]}
        return {"type": "Feature", "id": f"z{number}", "geometry": geometry, "properties": {"floor": "ground"}}

    with api(tmp_path) as here:
        for count, status in ((100_000, 413), (2000, 409), (500, 201)):
            drawn = b",".join(msgspec.json.encode(square(n)) for n in range(count))
            body = b'{"type": "FeatureCollection", "features": [' + drawn + b"]}"
            reply = here.client.post("/v1/zones", content=body, headers=AS_GEOJSON)
            assert reply.status_code == status, reply.text[:300]
        assert len(names(here)) == 502
        taken = here.client.post("/v1/zones", json=VAULT | {"id": "z7"})
        assert (taken.status_code, taken.json()["field"]) == (409, "id")


@pytest.mark.parametrize("crs", ["plan", "wgs84"])
def test_geojson_goes_out_and_comes_back_as_the_same_zones(crs: str, tmp_path: Path) -> None:
    site = hall(anchor=Anchor(latitude=48.8606, longitude=2.3376), north=60.0)
    with api(tmp_path, site) as here:
        here.client.post("/v1/zones", json=LINE)
        drawn = here.client.get(f"/v1/zones?crs={crs}", headers=AS_GEOJSON)
        assert drawn.headers["Content-Type"] == GEOJSON
        if crs == "wgs84":
            longitude, latitude = drawn.json()["features"][0]["geometry"]["coordinates"][0][0]
            assert (longitude, latitude) == (pytest.approx(2.3376, abs=0.001), pytest.approx(48.8606, abs=0.001))
        before = here.client.get("/v1/zones").json()["zones"]
        for zone in before:
            here.client.delete(f"/v1/zones/{zone['id']}")
        assert here.client.get("/v1/zones", headers=AS_GEOJSON).json()["features"] == []
        assert here.client.post(f"/v1/zones?crs={crs}", content=drawn.content, headers=AS_GEOJSON).status_code == 201
        after = here.client.get("/v1/zones").json()["zones"]
        for zone, again in zip(before, after, strict=True):
            assert again["rules"] == zone["rules"]
            np.testing.assert_allclose(again["points"], zone["points"], atol=0.002)
        one = here.client.get(f"/v1/zones/door?crs={crs}", headers=AS_GEOJSON)
        reply = here.client.put(f"/v1/zones/door?crs={crs}", content=one.content, headers=AS_GEOJSON)
        assert reply.status_code == 200, reply.text


@given(points=st.lists(st.tuples(st.floats(0, 20), st.floats(0, 12)), min_size=3, max_size=8), north=st.floats(-7, 7))
def test_what_is_accepted_on_earth_is_the_zone_on_the_plan(points: list[tuple[float, float]], north: float) -> None:
    earth = PlanOnEarth(48.8606, 2.3376, north)
    drawn = ZONE.draw(ZoneDefinition(id="z", floor="ground", points=points), earth)
    try:
        (zone,) = ZONE.read(json.dumps(drawn).encode(), FLOORS, geojson=True, earth=earth)
    except ProblemError:
        drawn_on = shapely.Polygon(points)
        assert not drawn_on.is_valid or drawn_on.area < 0.011 or shapely.minimum_clearance(drawn_on) < 0.01
        return
    # Corners that are one on Earth are one.
    assert shapely.hausdorff_distance(shapely.Polygon(zone.points), shapely.Polygon(points)) < 0.003


def test_wgs84_is_refused_where_nobody_knows_where_the_site_is(tmp_path: Path) -> None:
    with api(tmp_path, hall(anchor=None)) as here:
        reply = here.client.get("/v1/zones?crs=wgs84", headers=AS_GEOJSON)
        assert (reply.status_code, reply.json()["field"]) == (422, "crs")
        assert here.client.get("/v1/zones?crs=wgs84").status_code == 422
        assert here.client.get("/v1/zones?crs=mars", headers=AS_GEOJSON).status_code == 422
    with api(tmp_path, hall(anchor=Anchor(latitude=48.8606, longitude=2.3376))) as anchored:
        ring = [[0, 0], [1, 0], [1, 1], [0, 0]]
        far = {"type": "Feature", "id": "far", "geometry": {"type": "Polygon", "coordinates": [ring]}}
        far["properties"] = {"floor": "ground"}
        reply = anchored.client.post("/v1/zones?crs=wgs84", content=json.dumps(far), headers=AS_GEOJSON)
        assert (reply.status_code, reply.json()["field"]) == (422, "geometry.coordinates")


def test_all_zones_together_have_a_bound_and_as_many_hold_up_nobody(tmp_path: Path) -> None:
    ring = [(10 + 2 * math.cos(n * math.tau / 1000), 6 + 2 * math.sin(n * math.tau / 1000)) for n in range(1000)]
    with api(tmp_path, hall(zones=[])) as here:
        big = [VAULT | {"id": f"z{n}", "points": ring} for n in range(99)]
        definitions = msgspec.convert(big, list[ZoneDefinition])
        here.admin.zones.add(definitions)
        assert here.client.post("/v1/zones", json=VAULT).status_code == 201
        refused = here.client.post("/v1/zones", json=big[0] | {"id": "one-more"})
        assert (refused.status_code, refused.json()["field"]) == (422, "points")
        assert "at most 100000" in refused.json()["allowed"]
        assert here.client.put("/v1/zones/z7", json=big[7] | {"name": "as many"}).status_code == 200
        here.people(*[(None, 6.0 + n / 100.0, 6.0) for n in range(800)])
        began = time.process_time()
        for n in range(10):
            assert here.live.zones_json(n)
        assert time.process_time() - began < 1.0, "0.2 s for ten; 3.3 s where shapes are written and searched anew"


def test_coordinates_that_say_of_themselves_that_they_are_others_are_refused(tmp_path: Path) -> None:
    def sent(here: Api, name: object, query: str = "") -> httpx.Response:
        one = {**drawn["features"][0], "id": f"z-{len(query)}", "crs": {"type": "name", "properties": {"name": name}}}
        return here.client.post(f"/v1/zones{query}", content=json.dumps(one), headers=AS_GEOJSON)

    with api(tmp_path, hall(anchor=Anchor(latitude=48.8606, longitude=2.3376))) as here:
        reply = here.client.get("/v1/zones", headers=AS_GEOJSON)
        assert reply.headers["Vary"] == here.client.get("/v1/zones").headers["Vary"] == "Accept"
        drawn = reply.json()
        for name in ("urn:ogc:def:crs:EPSG::25832", "urn:ogc:def:crs:OGC:1.3:CRS84", 4326, None):
            refused = sent(here, name)
            assert (refused.status_code, refused.json()["field"]) == (422, "crs")
        assert sent(here, "plan metres").status_code == 201
        drawn = here.client.get("/v1/zones?crs=wgs84", headers=AS_GEOJSON).json()
        assert sent(here, "plan metres", "?crs=wgs84").status_code == 422
        assert sent(here, "urn:ogc:def:crs:OGC:1.3:CRS84", "?crs=wgs84").status_code == 201


@pytest.mark.parametrize(
    ("changes", "shape", "ids"),
    [
        ({"points": [[1, 1], [4, 4]], "rules": [{"kind": "cross"}]}, "line", ["cross"]),
        (
            {"points": [[1, 1], [4, 4], [4, 1]], "rules": [{"kind": "enter"}, {"kind": "exit"}]},
            "area",
            ["enter", "exit"],
        ),
        (
            {"rules": [{"kind": "dwell", "limit": limit} for limit in (1, 2, 3)] + [{"id": "dwell", "kind": "enter"}]},
            "area",
            ["dwell-2", "dwell-3", "dwell-4", "dwell"],
        ),
    ],
)
def test_what_a_zone_need_not_say(changes: dict[str, Any], shape: str, ids: list[str]) -> None:
    told = {name: value for name, value in VAULT.items() if name != "shape"} | changes
    (zone,) = ZONE.read(json.dumps(told).encode(), FLOORS, geojson=False, earth=None)
    assert (zone.shape, [rule.id for rule in zone.rules]) == (shape, ids)


def test_exhibits_are_kept_like_zones_and_begin_with_the_site_files(tmp_path: Path) -> None:
    vase = {"id": "vase", "name": "Vase", "floor": "ground", "x": 5.0, "y": 4.0, "facing": 90.0}
    with api(tmp_path) as here:
        beginning = [one["id"] for one in here.client.get("/v1/exhibits").json()["exhibits"]]
        assert beginning == ["vase", "statue", "model", "cabinet", "globe"]
        for name in beginning:
            assert here.client.delete(f"/v1/exhibits/{name}").status_code == 204
        made = here.client.post("/v1/exhibits", json=vase)
        assert made.status_code == 201, made.text
        assert made.json() == vase | {"reach": 8.0, "etag": made.headers["ETag"]}
        for changes, field in (
            ({"x": 300.0}, "x, y"),
            ({"reach": 0.0}, "reach"),
            ({"floor": "roof"}, "floor"),
            ({"id": "b"}, "id"),
        ):
            reply = here.client.put("/v1/exhibits/vase", json=vase | changes)
            assert (reply.status_code, reply.json()["field"]) == (422, field)
        drawn = here.client.get("/v1/exhibits", headers=AS_GEOJSON).json()["features"][0]
        assert drawn["geometry"] == {"type": "Point", "coordinates": [5.0, 4.0]}
        moved = drawn | {"geometry": {"type": "Point", "coordinates": [6.0, 4.0, 1.5]}}
        assert here.client.put("/v1/exhibits/vase", content=json.dumps(moved), headers=AS_GEOJSON).json()["x"] == 6.0
    with api(tmp_path) as later:
        assert [(e["id"], e["x"], e["facing"]) for e in later.client.get("/v1/exhibits").json()["exhibits"]] == [
            ("vase", 6.0, 90.0)
        ]
        assert later.client.delete("/v1/exhibits/vase").status_code == 204
        assert later.client.get("/v1/exhibits").json()["exhibits"] == []


def test_a_database_that_went_away_refuses_changes_and_loses_none(tmp_path: Path) -> None:
    with api(tmp_path) as here:
        assert here.client.post("/v1/zones", json=VAULT).status_code == 201
        here.close_database()
        (tmp_path / "api.db").rename(tmp_path / "away.db")
        reply = here.client.post("/v1/zones", json=VAULT | {"id": "other"})
        assert (reply.status_code, reply.headers["Retry-After"]) == (503, "5")
        assert "other" not in names(here)
        here.close_database()
        (tmp_path / "away.db").rename(tmp_path / "api.db")
        assert here.client.post("/v1/zones", json=VAULT | {"id": "other"}).status_code == 201


def test_a_second_process_on_one_database_is_told_and_overwrites_nothing(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/api.db"
    migrate(url)
    first, second = (Catalogue(open_admin(url), "zone", ZoneDefinition, [], 10) for _ in range(2))
    zone = ZoneDefinition(id="a", floor="ground", points=[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)])
    first.add([zone])
    with pytest.raises(ProblemError):
        second.add([msgspec.structs.replace(zone, id="b")])
    assert list(Catalogue(open_admin(url), "zone", ZoneDefinition, [], 10).entries) == ["a"]


@given(st.lists(st.tuples(st.floats(-5, 25), st.floats(-5, 15)), max_size=30), st.integers(0, 2**31))
def test_people_are_counted_as_one_by_one(people: list[tuple[float, float]], seed: int) -> None:
    generator = np.random.default_rng(seed)
    corners = generator.uniform((0.0, 0.0), (20.0, 12.0), (6, 2, 2))
    zones = [
        ZoneDefinition(
            id=f"z{n}",
            floor="ab"[n % 2],
            shape="line" if n == 5 else "area",
            points=[tuple(one), (other[0], one[1]), tuple(other), (one[0], other[1])][: 2 if n == 5 else 4],
        )
        for n, (one, other) in enumerate(corners.tolist())
    ]
    floor = np.array([str(generator.choice(["a", "b"])) for _ in people], dtype=object)
    x, y = np.array(people, dtype=float).reshape(-1, 2).T
    unseen = generator.random(len(people)) < 0.3
    areas = {zone.id: shapely.Polygon(zone.points) for zone in zones if zone.shape == "area"}
    everybody = People(floor, x, y, unseen)
    drawn = ZonesDrawn(zones, ["inside", *['"inside":0,"unseen":0'] * 5])
    reports = drawn.reports(everybody)
    assert msgspec.json.decode(drawn.reports_json(everybody), type=list[ZoneReport]) == reports
    for report, zone in zip(reports, zones, strict=True):
        inside = [
            zone.shape == "area" and floor[n] == zone.floor and areas[zone.id].intersects(shapely.Point(p))
            for n, p in enumerate(people)
        ]
        assert report.inside == sum(inside) - report.unseen
        assert report.unseen == sum(i and u for i, u in zip(inside, unseen, strict=True))


def test_doubled_corners_are_one(tmp_path: Path) -> None:
    with api(tmp_path) as here:
        ring = [[1, 1], [1, 1], [4, 1], [4, 4], [1, 4], [1, 1]]
        told = here.client.post("/v1/zones", json={"id": "room", "floor": "ground", "points": ring}).json()
        assert told["points"] == [[1, 1], [4, 1], [4, 4], [1, 4]]


def test_what_is_wanted_only_where_nothing_is_replaces_nothing(tmp_path: Path) -> None:
    with api(tmp_path) as here:
        zone = here.client.get("/v1/zones/entrance").json()
        refused = here.client.put("/v1/zones/entrance", json=zone | {"name": "x"}, headers={"If-None-Match": "*"})
        assert (refused.status_code, refused.json()["field"]) == (412, "If-None-Match")
        taken = here.client.post("/v1/zones", json={name: zone[name] for name in ("id", "floor", "points")})
        assert (taken.status_code, taken.json()["found"]) == (409, "entrance")
        wrong = here.client.post("/v1/zones/entrance", json={})
        assert (wrong.status_code, wrong.headers["Allow"]) == (405, "DELETE, GET, PUT")


@pytest.mark.parametrize("path", ["dwell", "heatmap?floor=ground", "occupancy", "alerts", "audit", "flows"])
def test_a_period_that_ends_before_it_begins_is_refused(path: str, tmp_path: Path) -> None:
    with api(tmp_path) as here:
        told = here.client.get(f"/v1/{path}{'&' if '?' in path else '?'}since=500000&until=1000")
        assert (told.status_code, told.json()["field"]) == (422, "until")
