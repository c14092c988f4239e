"""Staff sign in at the dashboard: their role holds there, and the audit log names them. A real API behind it."""

import asyncio
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from api_in_process import running
from conftest import unused_port
from fastapi import FastAPI
from waiting import wait_until

from services.dashboard.guesses import AttemptLimit, KnownBrowsers
from services.dashboard.pass_through import pass_through
from services.dashboard.sessions import Sessions
from services.dashboard.setup_relay import add_setup_relay
from services.dashboard.sign_in import add_sign_in
from services.dashboard.staff_desk import StaffDesk
from shared.bus import router
from shared.http_server import serve
from shared.site import load_site

KEY = "demo-api-key"
PASSWORD = "correct horse battery"
ZONE = {"id": "corner", "floor": "ground", "points": [[0, 0], [1, 0], [1, 1]]}


@pytest.fixture(scope="module")
def api(project: Path) -> Iterator[httpx.Client]:
    with pytest.MonkeyPatch.context() as patch:
        # How slowly a password is tried is not what is tested.
        patch.setattr("services.api.admin.passwords.LOG2_N", 4)
        yield from _api(project)


def _api(project: Path) -> Iterator[httpx.Client]:
    endpoint = f"tcp/127.0.0.1:{unused_port()}"
    session = router(endpoint)
    site = load_site(project / "deploy/sites/hall/site.yaml")
    with (
        running(site, project, endpoint, unused_port()) as url,
        httpx.Client(base_url=url, headers={"X-API-Key": KEY}) as client,
    ):
        for name, role in (("maria", "viewer"), ("otto", "curator")):
            made = client.post("/v1/users", json={"name": name, "role": role, "password": PASSWORD})
            assert made.status_code == 201, made.text
        yield client
    session.close()  # type: ignore[no-untyped-call]


class Desk:
    """A dashboard without its pages, and browsers of it."""

    def __init__(self, api_url: str, port: int, stopping: threading.Event) -> None:
        app, self.sessions, self.desk = FastAPI(), Sessions("", KEY, 1.0, staff_only=True), StaffDesk(api_url, KEY)
        app.include_router(pass_through(api_url, KEY))
        add_setup_relay(app, api_url, KEY)
        add_sign_in(app, self.sessions, AttemptLimit(), KnownBrowsers("", KEY), self.desk)
        self.url = f"http://127.0.0.1:{port}"
        self.thread = threading.Thread(target=serve, args=(app, "127.0.0.1", port, stopping), daemon=True)
        self.thread.start()

    def browser(self, name: str, password: str = PASSWORD, at: str = "127.0.0.1") -> tuple[httpx.Client, int]:
        """A new browser, and what it was answered when somebody signed in."""
        way = httpx.HTTPTransport(local_address=at, retries=5)
        made = httpx.Client(base_url=self.url, headers={"Sec-Fetch-Site": "same-origin"}, transport=way, timeout=20.0)
        return made, made.post("/login", data={"name": name, "password": password}).status_code


@pytest.fixture
def desk(api: httpx.Client) -> Iterator[Desk]:
    stopping = threading.Event()
    made = Desk(str(api.base_url).rstrip("/"), unused_port(), stopping)
    yield made
    stopping.set()
    made.thread.join(6)


def _audit(api: httpx.Client, **query: Any) -> list[tuple[str, str]]:
    entries = api.get("/v1/audit", params=query).json()["entries"]
    return [(entry["who"].partition(" ")[0], entry["subject"]) for entry in entries]


def test_a_role_holds_in_the_browser_and_the_audit_log_names_the_person(api: httpx.Client, desk: Desk) -> None:
    viewer, status = desk.browser("maria")
    assert status == 303
    told = viewer.get("/ask/v1/session").json()
    assert (told["name"], told["role"], "zones-admin" in told["scopes"]) == ("maria", "viewer", False)
    assert viewer.get("/ask/v1/positions/phone-of-ada").status_code in (200, 404)
    assert viewer.get("/ask/v1/alerts?device=phone-of-ada").status_code == 200
    refused = viewer.post("/ask/v1/zones", json=ZONE)
    assert (refused.status_code, "maria (viewer)" in refused.json()["detail"]) == (403, True)
    assert viewer.post("/setup/access-points", json={"positions": {}}).status_code == 403
    curator, _ = desk.browser("otto")
    assert curator.post("/ask/v1/zones", json=ZONE).status_code == 201
    assert ("otto", "/v1/zones/corner") in _audit(api, action="POST")
    entry = ("maria", "/v1/alerts?device=phone-of-ada")
    wait_until(lambda: entry in _audit(api, action="GET"), 10, "the look-up in the audit log")
    assert {who for who, _ in _audit(api, action="GET")} == {"maria"}


def test_signing_out_ends_the_session_here_and_at_the_api(api: httpx.Client, desk: Desk) -> None:
    browser, _ = desk.browser("maria")
    token = next(visitor.key for visitor in desk.sessions.staff())
    kept = {"Cookie": f"atrium_session={browser.cookies['atrium_session']}"}
    shown = {"Authorization": f"Bearer {token}", "X-API-Key": ""}
    assert api.get("/v1/session", headers=shown).json()["name"] == "maria"
    assert token not in str(browser.cookies)
    assert browser.post("/logout").status_code == 303
    assert browser.get("/session", headers=kept).status_code == 401
    assert api.get("/v1/session", headers=shown).status_code == 401


def test_who_gets_another_role_or_is_taken_out_is_signed_out_here_too(api: httpx.Client, desk: Desk) -> None:
    (working, _), (watching, _) = desk.browser("otto"), desk.browser("otto")
    api.put("/v1/users/otto", json={"role": "guard"})
    assert working.get("/ask/v1/zones").status_code == 401
    assert watching.get("/session").status_code == 204
    asyncio.run(desk.desk.look(desk.sessions.staff()))
    assert watching.get("/session").status_code == 401


def test_a_stranger_who_guesses_does_not_lock_out_whose_name_it_is(desk: Desk) -> None:
    known, _ = desk.browser("maria", at="127.0.1.1")
    assert [desk.browser("maria", "a guess", at="127.0.1.1")[1] for _ in range(6)] == [401] * 5 + [429]
    for stranger in ("127.0.1.2", "127.0.1.3"):
        assert [desk.browser("maria", "a guess", at=stranger)[1] for _ in range(5)] == [401] * 5
    assert desk.browser("maria", at="127.0.1.1")[1] == 429
    assert desk.browser("maria", at="127.0.1.4")[1] == 303
    known.post("/logout")
    assert known.post("/login", data={"name": "maria", "password": PASSWORD}).status_code == 303
