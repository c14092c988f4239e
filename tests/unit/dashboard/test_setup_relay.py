"""What the set-up pages ask goes to the API with the dashboard's key, and only for people who signed in."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import httpx
import pytest
from conftest import unused_port
from fastapi import FastAPI
from waiting import wait_until

from services.dashboard.guesses import AttemptLimit, KnownBrowsers
from services.dashboard.sessions import Sessions
from services.dashboard.setup_relay import add_setup_relay
from services.dashboard.sign_in import add_sign_in
from services.dashboard.staff_desk import StaffDesk
from shared.http_server import serve

KEY = "the-key-of-the-dashboard"
HERE = {"Sec-Fetch-Site": "same-origin"}


class Api(BaseHTTPRequestHandler):
    """Tells what it was asked."""

    def do_GET(self) -> None:
        self._tell(b"")

    def do_POST(self) -> None:
        self._tell(self.rfile.read(int(self.headers["Content-Length"])))

    def _tell(self, body: bytes) -> None:
        status = 401 if "garden" in self.path else 409 if "busy" in self.path else 200
        told = {"path": self.path, "key": self.headers["Authorization"], "body": body.decode(), "detail": "no"}
        content = json.dumps(told).encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(content)))
        self.send_header("X-Atrium-Taken", "12.5")
        self.send_header("X-Other", "kept inside")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        """Stay silent."""


@pytest.fixture(scope="module")
def api() -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Api)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()


@contextmanager
def client(api: str, password: str = "") -> Iterator[httpx.Client]:
    app = FastAPI()
    add_setup_relay(app, api, KEY)
    sessions, browsers = Sessions(password, KEY, 1.0), KnownBrowsers(password, KEY)
    add_sign_in(app, sessions, AttemptLimit(), browsers, StaffDesk(api, KEY))
    port, stopping = unused_port(), threading.Event()
    thread = threading.Thread(target=serve, args=(app, "127.0.0.1", port, stopping), daemon=True)
    thread.start()
    with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=10.0, headers=HERE) as http:
        wait_until(lambda: _answers(http), 10, "the dashboard")
        yield http
    stopping.set()
    thread.join(6)


def _answers(http: httpx.Client) -> bool:
    try:
        return http.get("/login").status_code in (200, 303)
    except httpx.TransportError:
        return False


@pytest.fixture(scope="module")
def browser(api: str) -> Iterator[httpx.Client]:
    with client(api) as http:
        yield http


def test_questions_and_orders_reach_the_api_with_the_key(browser: httpx.Client) -> None:
    told = browser.get("/setup/cameras/door/board?columns=9&rows=6")
    assert told.json()["path"] == "/v1/cameras/door/board?columns=9&rows=6"
    assert told.json()["key"] == f"Bearer {KEY}"
    assert told.headers["x-atrium-taken"] == "12.5"
    assert "x-other" not in told.headers
    sent = browser.post("/setup/cameras/door/calibration/try", json={"pairs": []})
    assert json.loads(sent.json()["body"]) == {"pairs": []}
    assert browser.get("/setup/cameras/busy/still").status_code == 409


@pytest.mark.parametrize(
    "path",
    ["positions", "cameras/door/positions", "cameras/door/..%2f..%2fpositions", "cameras/a%20b/still", "learning"],
)
def test_nothing_else_does(browser: httpx.Client, path: str) -> None:
    assert browser.get(f"/setup/{path}").status_code == 404


def test_forms_of_other_sites_and_floods_are_refused(browser: httpx.Client) -> None:
    assert browser.post("/setup/access-points", data={"positions": "x"}).status_code == 415
    assert (
        browser.post("/setup/access-points", content=b"{}", headers={"content-type": "text/plain"}).status_code == 415
    )
    flood = browser.post(
        "/setup/access-points", content=b" " * (1 << 20) + b"x", headers={"content-type": "application/json"}
    )
    assert flood.status_code == 413
    elsewhere = {"Sec-Fetch-Site": "cross-site"}
    assert browser.post("/setup/access-points", json={}, headers=elsewhere).status_code == 403


def test_who_has_not_signed_in_gets_nothing(api: str) -> None:
    with client(api, password="a long password") as stranger:
        assert stranger.get("/setup/cameras/door/still").status_code == 401
        assert stranger.post("/setup/access-points", json={}).status_code == 401


def test_a_wrong_key_or_no_api_is_no_matter_of_the_browsers_session(browser: httpx.Client) -> None:
    refused = browser.get("/setup/cameras/garden/still")
    assert (refused.status_code, refused.json()["detail"]) == (502, "the API does not know this dashboard's key")
    with client(f"http://127.0.0.1:{unused_port()}") as alone:
        gone = alone.get("/setup/site")
    assert (gone.status_code, gone.json()["detail"]) == (502, "the API does not answer; is it running?")
