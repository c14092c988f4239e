"""The past over HTTP: a real router, a real history service and its database, every format read back."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pyarrow.parquet
import pytest
import schemathesis
from api_in_process import running as api
from atrium_client import AtriumClient
from conftest import unused_port
from history_in_process import DEADLINE, Teller
from history_in_process import running as history
from history_world import NOON
from hypothesis import HealthCheck, given, settings
from hypothesis.errors import Unsatisfiable
from schemathesis.generation import GenerationMode
from waiting import wait_until

from services.history.database import migrate
from shared.bus import Bus, router
from shared.site import Site, load_site
from shared.site.geographic import PlanOnEarth
from shared.zones import ZoneDefinition

KEY = {"X-API-Key": "demo-api-key"}
HOUR = f"since={NOON}&until={NOON + 3600}"
PATHS = ("/v1/trajectories/d-1", "/v1/occupancy", "/v1/heatmap", "/v1/dwell", "/v1/flows")
WEST = [(4.0, 0.0), (9.0, 0.0), (9.0, 12.0), (4.0, 12.0)]
EAST = [(11.0, 0.0), (16.0, 0.0), (16.0, 12.0), (11.0, 12.0)]


@pytest.fixture(scope="module")
def site(project: Path) -> Site:
    return load_site(project / "deploy/sites/hall/site.yaml")


@pytest.fixture(scope="module")
def address(site: Site, project: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """An API with a history of one minute in which twenty-four people walked round."""
    folder = tmp_path_factory.mktemp("history")
    migrate(f"sqlite:///{folder / 'history.db'}")
    endpoint = f"tcp/127.0.0.1:{unused_port()}"
    broker = router(endpoint)
    with (
        Bus([endpoint]) as bus,
        history(site, project, endpoint, folder),
        api(site, project, endpoint, unused_port()) as url,
    ):
        teller = Teller(bus)
        teller.zones(
            1,
            [
                ZoneDefinition(id="west", floor="ground", points=WEST),
                ZoneDefinition(id="east", floor="ground", points=EAST),
            ],
        )
        teller.walk(0, 60, people=24)
        path = f"/v1/trajectories/d-1?{HOUR}"
        wait_until(lambda: len(get(url, path).json()["t"]) == 60, DEADLINE, "the walk to be stored")
        yield url
    broker.close()  # type: ignore[no-untyped-call]


def get(address: str, path: str, status: int = 200) -> httpx.Response:
    answer = httpx.get(address + path, headers=KEY, timeout=10.0)
    assert answer.status_code == status, answer.text
    return answer


def test_a_way_comes_in_every_format_and_they_agree(address: str, site: Site) -> None:
    path = f"/v1/trajectories/d-1?{HOUR}"
    body = get(address, path).json()
    assert body["t"] == [NOON + second for second in range(60)]
    assert set(body["state"]) == {"confirmed"}
    assert set(body["floor"]) == {"ground"}
    rows = list(csv.DictReader(io.StringIO(get(address, f"{path}&format=csv").text)))
    table = pyarrow.parquet.read_table(io.BytesIO(get(address, f"{path}&format=parquet").content)).to_pydict()
    (feature,) = get(address, f"{path}&format=geojson").json()["features"]
    for column in ("t", "x", "y", "accuracy", "probability"):
        assert [float(row[column]) for row in rows] == body[column] == table[column]
    assert feature["geometry"]["type"] == "LineString"
    earth = PlanOnEarth.of(site)
    assert earth is not None
    places = earth.to_plan(np.array(feature["geometry"]["coordinates"]))
    np.testing.assert_allclose(places, np.column_stack([body["x"], body["y"]]), atol=0.002)
    assert feature["properties"]["t"] == body["t"]
    thinned = get(address, f"{path}&step=10").json()
    assert len(thinned["t"]) == 6
    assert get(address, f"/v1/trajectories/d-nobody?{HOUR}&format=csv").text.count("\r\n") == 1
    assert get(address, f"/v1/trajectories/d-nobody?{HOUR}&format=geojson").json()["features"] == []


def test_sums_over_everybody_come_as_columns_and_as_tables(address: str) -> None:
    dwell = get(address, f"/v1/dwell?{HOUR}").json()
    assert [(row["id"], row["people"]) for row in dwell["places"]] == [("west", 24), ("east", 24)]
    assert all(row["mean"] > 5.0 for row in dwell["places"])
    flows = get(address, f"/v1/flows?{HOUR}").json()
    assert flows["zones"] == ["west", "east"]
    assert flows["counts"][0][1] >= 21
    assert flows["counts"][1][0] >= 21
    legs = list(csv.DictReader(io.StringIO(get(address, f"/v1/flows?{HOUR}&format=csv").text)))
    assert [(row["from"], row["to"]) for row in legs] == [("west", "east"), ("east", "west")]
    heat = get(address, f"/v1/heatmap?{HOUR}&cell=1").json()
    told = [value for row in heat["seconds"] for value in row if value is not None]
    assert len(told) > 10
    assert sum(told) <= 1440.0
    assert (heat["origin"], heat["cell"], len(heat["people"])) == ([0.0, 0.0], 1.0, len(heat["seconds"]))
    series = get(address, f"/v1/occupancy?{HOUR}&of=area&step=60").json()
    assert (series["places"][0]["id"], series["places"][0]["most"][:2]) == ("hall", [24, None])
    table = get(address, f"/v1/occupancy?{HOUR}&of=area&step=60&format=parquet").content
    assert pyarrow.parquet.read_table(io.BytesIO(table)).to_pydict()["people"][:2] == [24.0, None]
    day = get(address, "/v1/dwell?day=2026-01-01").json()
    assert (day["since"], day["until"]) == (1767225600.0, 1767312000.0)
    assert day["places"] == dwell["places"]
    today = get(address, "/v1/dwell").json()
    assert today["until"] - today["since"] <= 86400.0
    assert 0.0 <= today["until"] - time.time() + 60.0 < 1020.0, "in whole quarter hours"
    places = get(address, f"/v1/dwell?{HOUR}&at=exhibits").json()["places"]
    assert [place["id"] for place in places] == ["vase", "statue", "model", "cabinet", "globe"]


def test_the_client_reads_the_past_as_the_api_tells_it(address: str) -> None:
    period = {"since": NOON, "until": NOON + 3600.0}
    with AtriumClient(address, KEY["X-API-Key"]) as atrium:
        way = atrium.trajectory("d-1", **period, step=10.0)
        assert (len(way.t), way.floor[0], set(way.state)) == (6, "ground", {"confirmed"})
        assert [place.id for place in atrium.occupancy(**period).places] == ["east", "west"]
        heat = atrium.heat_map("ground", cell=1.0, **period)
        assert any(value is not None for row in heat.seconds for value in row)
        assert [(place.id, place.people) for place in atrium.dwell(**period).places] == [("west", 24), ("east", 24)]
        assert len(atrium.dwell(**period, at="exhibits").places) == 5
        assert (atrium.flows(**period).counts[0][1] or 0) >= 21


def test_bad_input_names_field_and_what_is_allowed(address: str) -> None:
    for path, status, field in (
        (f"/v1/trajectories/d-1?since={NOON}&until={NOON - 1}", 422, "until"),
        (f"/v1/trajectories/d-1?since={NOON}&until={NOON + 1e6}", 422, "until"),
        ("/v1/trajectories/d-1?since=nan", 422, "since"),
        ("/v1/trajectories/d-1?since=1e300", 422, "since"),
        ("/v1/trajectories/d-1?day=yesterday", 422, "day"),
        ("/v1/trajectories/d-1?day=9999-12-31", 422, "day"),
        (f"/v1/trajectories/d-1?day=2026-01-01&since={NOON}", 422, "day"),
        ("/v1/trajectories/d-1?format=xml", 422, "format"),
        (f"/v1/occupancy?zone=nowhere&{HOUR}", 404, "zone"),
        (f"/v1/occupancy?step=61&{HOUR}", 422, "step"),
        (f"/v1/heatmap?floor=roof&{HOUR}", 404, "floor"),
        (f"/v1/heatmap?cell=0&{HOUR}", 422, "cell"),
        (f"/v1/flows?within=0&{HOUR}", 422, "within"),
    ):
        problem = get(address, path, status).json()
        assert (problem["field"], bool(problem["allowed"])) == (field, True), path
    assert get(address, "/v1/trajectories/no%20id", 404).json()["field"] == "device"


def test_nothing_generated_from_the_page_of_history_breaks_it(address: str) -> None:
    page = schemathesis.openapi.from_dict(httpx.get(f"{address}/openapi.json").json())
    tried = set()
    for result in page.get_all_operations():
        operation = result.ok()
        if operation.path.split("/")[2] not in ("trajectories", "occupancy", "heatmap", "dwell", "flows"):
            continue
        tried.add(operation.path)
        for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE):
            try:
                cases = operation.as_strategy(generation_mode=mode)

                @settings(max_examples=8, deadline=None, database=None, suppress_health_check=list(HealthCheck))
                @given(cases)
                def send(case: schemathesis.Case) -> None:
                    answer = case.call(base_url=address, headers=KEY)
                    assert answer.status_code < 500, answer.text
                    if answer.status_code >= 400:
                        assert answer.json()["status"] == answer.status_code

                send()
            except Unsatisfiable:
                continue  # what has no inputs has no wrong ones
    assert len(tried) == len(PATHS)


def test_without_history_the_answer_says_so_and_the_rest_works(
    site: Site, project: Path, zenoh_router: str, free_port: int
) -> None:
    with api(site, project, zenoh_router, free_port) as address:
        for path in PATHS:
            answer = get(address, path, 503)
            assert answer.headers["Retry-After"] == "5"
            assert "the history service is not running" in answer.json()["detail"]
        get(address, "/v1/positions")
