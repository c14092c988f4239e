"""The learning side of the API: a real router, a stand-in that answers learning's queries, real HTTP."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import httpx
import msgspec
import pytest
import schemathesis
import structlog
from api_in_process import running
from conftest import unused_port
from hypothesis import HealthCheck, given, settings
from hypothesis.errors import Unsatisfiable
from learning_double import AREA, Double, fresh, learning
from schemathesis.generation import GenerationMode

from services.api.learning_replies import Learning
from shared.bus import Bus, router
from shared.learning_command import LearningAnswer
from shared.learning_report import AreaLessons, MapGrid
from shared.site import Site, load_site

KEYS = json.dumps(
    [
        {"name": "office", "key": "the-key-of-the-office", "scopes": ["learning", "learning-admin", "positions"]},
        {"name": "screen", "key": "the-key-of-a-screen-1", "scopes": ["learning"]},
        {"name": "guide", "key": "the-key-of-the-guides", "scopes": ["positions"]},
    ]
)
OFFICE, SCREEN, GUIDE = ("the-key-of-the-office", "the-key-of-a-screen-1", "the-key-of-the-guides")


@pytest.fixture(scope="module")
def site(project: Path) -> Site:
    return load_site(project / "deploy/sites/hall/site.yaml")


@pytest.fixture(scope="module")
def system(site: Site, project: Path) -> Iterator[tuple[str, Double]]:
    endpoint = f"tcp/127.0.0.1:{unused_port()}"
    broker = router(endpoint)
    with (
        Bus([endpoint]) as bus,
        learning(bus, site) as double,
        running(site, project, endpoint, unused_port(), api_keys=KEYS) as address,
    ):
        yield address, double
    broker.close()


def get(address: str, path: str, status: int = 200, key: str = OFFICE) -> dict[str, object]:
    answer = httpx.get(f"{address}/v1/learning{path}", headers={"X-API-Key": key}, timeout=10.0)
    assert answer.status_code == status, answer.text
    body: dict[str, object] = answer.json()
    return body


def post(address: str, path: str, body: object = None, status: int = 200, key: str = OFFICE) -> dict[str, object]:
    content = body if isinstance(body, bytes) else json.dumps(body).encode()
    answer = httpx.post(f"{address}/v1/learning{path}", headers={"X-API-Key": key}, content=content, timeout=10.0)
    assert answer.status_code == status, answer.text
    told: dict[str, object] = answer.json()
    return told


def test_everything_is_told_and_many_readers_ask_learning_once(system: tuple[str, Double]) -> None:
    address, double = system
    before = double.asked
    bodies = [get(address, "") for _ in range(20)]
    whole = msgspec.convert(bodies[-1], Learning)
    assert (whole.areas, whole.devices, whole.may_change) == (double.report.areas, double.report.devices, True)
    assert msgspec.convert(get(address, f"/areas/{AREA}"), AreaLessons) == double.report.areas[0]
    fits = get(address, f"/access-points?area={AREA}")["access_points"]
    assert [row["fit"]["access_point"] for row in fits] == [
        f.access_point for f in double.report.areas[0].access_points
    ]  # type: ignore[attr-defined]
    assert get(address, "/cameras")["cameras"] == msgspec.to_builtins(double.report.cameras)
    assert get(address, "/accuracy")["areas"][0]["accuracy"]["p90"] == 1.35  # type: ignore[index]
    assert double.asked - before <= 4


def test_who_may_not_know_who_is_where_learns_nothing_of_single_phones(system: tuple[str, Double]) -> None:
    address, double = system
    phone = double.report.devices[0].device
    assert phone in json.dumps(get(address, ""))
    for path in ("", "/history"):
        assert phone not in json.dumps(get(address, path, key=SCREEN))
    assert get(address, "/devices", 403, SCREEN)["allowed"] == "a key with the scope positions, too"
    assert len(get(address, "/devices")["devices"]) == 4  # type: ignore[arg-type]
    assert get(address, "", 403, GUIDE)["allowed"] == "a key with the scope learning"


def test_history_comes_in_pages_that_lose_nothing(system: tuple[str, Double]) -> None:
    address, double = system
    seen: list[object] = []
    query = "?limit=4"
    while True:
        page = get(address, f"/history{query}")
        seen += page["history"]  # type: ignore[arg-type]
        if page["next"] is None:
            break
        query = f"?limit=4&before={page['next']}"
    assert seen == msgspec.to_builtins(double.report.history)
    assert {row["decision"] for row in get(address, "/history?kind=radio")["history"]} == {"activated", "refused"}  # type: ignore[attr-defined]
    assert len(get(address, "/history?subject=hall-east")["history"]) == 2  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ["visits", "occlusion", "radio", "shadowing", "magnetic"])
def test_maps_come_as_numbers_and_as_pictures(system: tuple[str, Double], site: Site, kind: str) -> None:
    address, _ = system
    point = site.access_points[0].id
    query = f"?access_point={point}" if kind in ("radio", "shadowing") else ""
    grid = msgspec.convert(get(address, f"/maps/{AREA}/{kind}{query}"), MapGrid)
    known = [value for row in grid.rows for value in row if value is not None]
    assert len(known) > 100
    assert grid.subject == (point if query else "")
    picture = httpx.get(f"{address}/v1/learning/maps/{AREA}/{kind}.svg{query}", headers={"X-API-Key": OFFICE})
    assert picture.headers["content-type"] == "image/svg+xml"
    drawn = ElementTree.fromstring(picture.content)
    assert len(drawn.findall(".//{http://www.w3.org/2000/svg}path")) > 4
    assert "http" not in picture.text.replace("http://www.w3.org/2000/svg", "")
    assert len(picture.content) < 200_000


def test_an_operator_rolls_back_freezes_exports_and_imports(system: tuple[str, Double]) -> None:
    address, double = system
    with structlog.testing.capture_logs() as told_in_log:
        done = post(address, "/rollback", {"kind": "radio", "subject": AREA})
    (line,) = [entry for entry in told_in_log if entry["event"] == "an order to learning"]
    assert (line["order"], line["by"], line["subject"], line["done"]) == ("rollback", "office", AREA, True)
    assert done == {"words": "area hall is back at radio model 2, as version 4", "version": 4}
    assert (double.commands[-1].do, double.commands[-1].by) == ("rollback", "office")
    post(address, "/freeze")
    assert get(address, "")["frozen"] is True
    post(address, "/unfreeze")
    assert get(address, "")["frozen"] is False
    bundle = get(address, "/export")
    assert post(address, "/import", bundle)["words"] == "0 models brought in"
    assert json.loads(bytes(double.commands[-1].bundle)) == bundle
    post(address, "/import?as_site=true&area=nave:hall&camera=west:hall-east", bundle)
    told = double.commands[-1]
    assert (told.as_site, told.areas, told.cameras) == (True, {"nave": "hall"}, {"west": "hall-east"})
    get(address, "/export?personal=true")
    assert double.commands[-1].personal


def test_a_key_that_only_reads_changes_nothing(system: tuple[str, Double]) -> None:
    address, double = system
    before = len(double.commands)
    for path in ("/rollback", "/freeze", "/unfreeze", "/import"):
        assert post(address, path, {}, 403, SCREEN)["allowed"] == "a key with the scope learning-admin"
    get(address, "/export", 403, SCREEN)
    assert get(address, "", key=SCREEN)["may_change"] is False
    assert len(double.commands) == before


def test_bad_input_names_field_and_what_is_allowed(system: tuple[str, Double]) -> None:
    address, double = system
    for path, status, field in (
        ("/areas/nowhere", 404, "area"),
        ("/access-points?area=nowhere", 404, "area"),
        ("/history?limit=0", 422, "limit"),
        ("/history?before=nan", 422, "before"),
        ("/history?kind=colour", 422, "kind"),
        ("/maps/nowhere/visits", 404, "area"),
        (f"/maps/{AREA}/colours", 404, "map"),
        (f"/maps/{AREA}/radio", 404, "access_point"),
        (f"/maps/{AREA}/radio.svg?access_point=ap-99", 404, "access_point"),
        ("/rollback", 405, "method"),
    ):
        problem = get(address, path, status)
        assert (problem["field"], bool(problem["allowed"])) == (field, True), path
    for body, field in (
        (b"{", "body"),
        ({"kind": "radio"}, "subject"),
        ({"kind": "colour", "subject": AREA}, "kind"),
        ({"kind": "radio", "subject": AREA, "when": 1}, "when"),
        ([], "body"),
    ):
        assert post(address, "/rollback", body, 422)["field"] == field
    problem = post(address, "/rollback", {"kind": "colour", "subject": AREA}, 422)
    assert "colour" in problem["found"]
    assert "radio, detector, stride, heading, alignment" in problem["allowed"]
    assert post(address, "/rollback", {"kind": "radio", "subject": "nowhere"}, 404)["field"] == "subject"
    assert post(address, "/rollback", {"kind": "radio", "subject": "x" * 5000}, 413)["field"] == "body"
    for body in (b"", b"[]", b"{"):
        assert post(address, "/import", body, 422)["field"] == "body"
    for query, field in (("area=nave", "area"), ("camera=a:b:c", "camera"), ("as_site=perhaps", "as_site")):
        assert post(address, f"/import?{query}", {}, 422)["field"] == field
    assert post(address, "/import", {"site": "other-site"}, 422)["field"] == "bundle"
    double.refusal = LearningAnswer(done=False, words="there is no older version")
    refused = post(address, "/rollback", {"kind": "radio", "subject": AREA}, 409)
    double.refusal = None
    assert refused["detail"] == "there is no older version"


def test_nothing_generated_from_the_page_of_learning_breaks_it(system: tuple[str, Double]) -> None:
    address, _ = system
    page = schemathesis.openapi.from_dict(httpx.get(f"{address}/openapi.json").json())
    tried = set()
    for result in page.get_all_operations():
        operation = result.ok()
        if not operation.path.startswith("/v1/learning"):
            continue
        tried.add(operation.path)
        for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE):
            try:
                cases = operation.as_strategy(generation_mode=mode)

                @settings(max_examples=3, deadline=None, database=None, suppress_health_check=list(HealthCheck))
                @given(cases)
                def send(case: schemathesis.Case) -> None:
                    answer = case.call(base_url=address, headers={"X-API-Key": OFFICE})
                    assert answer.status_code < 500, answer.text
                    if answer.status_code >= 400:
                        assert answer.json()["status"] == answer.status_code

                send()
            except Unsatisfiable:
                continue  # what has no inputs has no wrong ones
    assert len(tried) == 14


def test_without_learning_the_answer_says_so_and_the_rest_works(
    site: Site, project: Path, zenoh_router: str, free_port: int
) -> None:
    with running(site, project, zenoh_router, free_port) as address, Bus([zenoh_router]) as bus:
        headers = {"X-API-Key": "demo-api-key"}
        for path in ("", "/cameras", f"/maps/{AREA}/visits"):
            answer = httpx.get(f"{address}/v1/learning{path}", headers=headers, timeout=10.0)
            assert answer.status_code == 503
            assert answer.headers["Retry-After"] == "5"
            assert "the learning service is not running" in answer.json()["detail"]
        assert httpx.post(f"{address}/v1/learning/freeze", headers=headers, timeout=10.0).status_code == 503
        assert httpx.get(f"{address}/v1/positions", headers=headers).status_code == 200
        with learning(bus, site, fresh(site)):
            missing = httpx.get(f"{address}/v1/learning/maps/{AREA}/visits", headers=headers, timeout=10.0)
            assert (missing.status_code, missing.json()["detail"]) == (404, "Nobody with a phone has walked yet.")


def test_an_answer_that_makes_no_sense_is_told_as_such(
    site: Site, project: Path, zenoh_router: str, free_port: int
) -> None:
    from shared.keys import Keys

    with running(site, project, zenoh_router, free_port) as address, Bus([zenoh_router]) as bus:
        bus.answer(Keys(site.site).learning_report(), lambda: b'{"t": "soon"}')
        answer = httpx.get(f"{address}/v1/learning", headers={"X-API-Key": "demo-api-key"}, timeout=10.0)
        assert answer.status_code == 503
        assert "same version" in answer.json()["detail"]
