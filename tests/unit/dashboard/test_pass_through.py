"""What pages may ask of the API through the dashboard, and what they may not."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from api_double import KEY, Double, running
from conftest import unused_port
from fastapi import FastAPI
from fastapi.testclient import TestClient

from services.dashboard.guesses import AttemptLimit, KnownBrowsers
from services.dashboard.pass_through import LARGEST_BODY, pass_through
from services.dashboard.sessions import Sessions
from services.dashboard.sign_in import add_sign_in
from services.dashboard.staff_desk import StaffDesk
from shared.site import load_site

HERE = {"Sec-Fetch-Site": "same-origin"}
ZONE = {"id": "corner", "floor": "ground", "points": [[0, 0], [1, 0], [1, 1]]}


@pytest.fixture(scope="module")
def api(project: Path) -> Iterator[tuple[str, Double]]:
    port = unused_port()
    with running(load_site(project / "deploy/sites/hall/site.yaml"), port) as double:
        yield f"http://127.0.0.1:{port}", double


@pytest.fixture
def pages(api: tuple[str, Double]) -> Iterator[TestClient]:
    with _client(api[0], KEY) as client:
        yield client


def test_a_change_of_our_own_page_reaches_the_api_with_the_key(pages: TestClient, api: tuple[str, Double]) -> None:
    answer = pages.post("/ask/v1/zones", json=ZONE, headers=HERE)
    assert answer.status_code == 201
    assert answer.json()["id"] == "corner"
    assert "corner" in api[1].zones
    etag = api[1].zones["corner"]["etag"]
    stale = pages.put("/ask/v1/zones/corner", json=ZONE, headers=HERE | {"If-Match": '"older"'})
    assert stale.status_code == 412
    assert pages.put("/ask/v1/zones/corner", json=ZONE, headers=HERE | {"If-Match": etag}).status_code == 200
    assert pages.delete("/ask/v1/zones/corner", headers=HERE).status_code == 204


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
        {"Origin": "https://elsewhere.example"},
        {"Sec-Fetch-Site": "cross-site", "Origin": "http://testserver"},
    ],
)
def test_another_sites_page_changes_nothing(
    pages: TestClient, api: tuple[str, Double], headers: dict[str, str]
) -> None:
    before = len(api[1].asked)
    assert pages.post("/ask/v1/zones", json=ZONE, headers=headers).status_code == 403
    assert len(api[1].asked) == before


def test_a_browser_without_fetch_metadata_is_known_by_its_origin(pages: TestClient) -> None:
    answer = pages.post("/ask/v1/zones", json={**ZONE, "id": "other"}, headers={"Origin": "http://testserver"})
    assert answer.status_code == 201


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("GET", "v1/stream"),
        ("GET", "v1/learning/export"),
        ("GET", "docs"),
        ("GET", "v1/zones/../learning/export"),
        ("GET", "v1/zones%2f..%2flearning/export"),
        ("GET", "v1/positions/.."),
        ("POST", "v1/learning/freeze"),
        ("POST", "v1/webhooks"),
        ("DELETE", "v1/zones"),
        ("DELETE", "v1/devices"),
        ("DELETE", "v1/devices/d-1/tokens"),
        ("GET", "v1/privacy"),
        ("DELETE", "v1/zones/..%2falerts"),
        ("PUT", "v1/alerts/605d049a-1"),
    ],
)
def test_nothing_but_what_pages_need_is_passed_on(
    pages: TestClient, api: tuple[str, Double], method: str, path: str
) -> None:
    before = len(api[1].asked)
    assert pages.request(method, f"/ask/{path}", headers=HERE).status_code in (404, 405)
    assert len(api[1].asked) == before


def test_a_body_too_large_is_refused_here(pages: TestClient, api: tuple[str, Double]) -> None:
    before = len(api[1].asked)
    assert pages.post("/ask/v1/zones", content=b"x" * (LARGEST_BODY + 1), headers=HERE).status_code == 413
    assert len(api[1].asked) == before


def test_a_key_that_the_api_refuses_does_not_send_people_to_the_sign_in_page(api: tuple[str, Double]) -> None:
    with _client(api[0], "some-other-key") as client:
        answer = client.get("/ask/v1/zones")
    assert answer.status_code == 403
    assert "ATRIUM_API_KEY" in answer.json()["detail"]
    assert "some-other-key" not in answer.text


def test_an_api_that_is_away_is_told_in_words() -> None:
    with _client(f"http://127.0.0.1:{unused_port()}", KEY) as client:
        answer = client.get("/ask/v1/zones")
    assert (answer.status_code, answer.json()["detail"]) == (502, "The API does not answer; is it running?")


def test_strangers_ask_nothing(api: tuple[str, Double]) -> None:
    with _client(api[0], KEY, "a long password") as client:
        before = len(api[1].asked)
        assert client.get("/ask/v1/zones").status_code == 401
        assert client.post("/ask/v1/zones", json=ZONE, headers=HERE).status_code == 401
        assert len(api[1].asked) == before


def _client(api_url: str, key: str, password: str = "") -> TestClient:
    app = FastAPI()
    app.include_router(pass_through(api_url, key))
    sessions, browsers = Sessions(password, key, 1.0), KnownBrowsers(password, key)
    add_sign_in(app, sessions, AttemptLimit(), browsers, StaffDesk(api_url, key))
    return TestClient(app)
