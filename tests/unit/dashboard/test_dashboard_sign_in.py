import http.cookies
import socket
from collections.abc import Iterator

import httpx
import pytest
from served import served

PASSWORD = "open sesame"
HERE = {"Sec-Fetch-Site": "same-origin"}
HTML = {"Accept": "text/html,*/*"}


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with served(port, "http://127.0.0.1:9", PASSWORD, proxies=["127.0.0.4"]) as url:
        yield url


@pytest.fixture
def client(address: str) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=address, headers=HERE) as opened:
        yield opened


def _from(source: str, address: str) -> httpx.Client:
    """A client of an address of its own, so that the limit of another test does not interfere."""
    return httpx.Client(base_url=address, headers=HERE, transport=httpx.HTTPTransport(local_address=source))


def test_a_stranger_sees_the_sign_in_page_and_nothing_else(client: httpx.Client) -> None:
    page = client.get("/", headers=HTML)
    assert (page.status_code, page.headers["location"]) == (303, "/login")
    assert client.get("/login").status_code == 200
    for path in ("/live", "/session", "/static/live.js", "/_nicegui_ws/socket.io/", "/docs", "/openapi.json"):
        assert client.get(path).status_code == 401, path


def test_the_password_opens_and_signing_out_closes(client: httpx.Client) -> None:
    answer = client.post("/login", data={"password": PASSWORD})
    assert (answer.status_code, answer.headers["location"]) == (303, "/")
    for cookie in answer.headers.get_list("set-cookie"):
        assert "httponly" in cookie.lower()
        assert "samesite=lax" in cookie.lower()
        assert "secure" not in cookie.lower()
    assert client.get("/session").status_code == 204
    assert client.get("/static/live.js").status_code == 200
    with client.stream("GET", "/live") as live:
        assert live.headers["content-type"].startswith("text/event-stream")
        kept = {"Cookie": f"atrium_session={client.cookies['atrium_session']}"}
        assert client.get("/session", headers=kept).status_code == 204
        assert client.post("/logout").status_code == 303
        for _ in live.iter_bytes():
            pass  # the stream ends, too
    assert client.get("/session").status_code == 401
    assert client.get("/session", headers=kept).status_code == 401, "who kept the cookie is signed out, too"


def test_a_cookie_that_came_by_https_never_goes_back_in_the_clear(address: str) -> None:
    forwarded = {"X-Forwarded-For": "198.51.100.7", "X-Forwarded-Proto": "https"}
    for source, secure in (("127.0.0.4", True), ("127.0.0.5", False)):
        with _from(source, address) as proxy:
            answer = proxy.post("/login", data={"password": PASSWORD}, headers=forwarded)
            cookies = [http.cookies.SimpleCookie(text) for text in answer.headers.get_list("set-cookie")]
            assert [bool(morsel["secure"]) for cookie in cookies for morsel in cookie.values()] == [secure] * 2


def test_a_page_of_another_site_neither_signs_in_nor_out(client: httpx.Client) -> None:
    elsewhere = {"Sec-Fetch-Site": "cross-site"}
    assert client.post("/login", data={"password": PASSWORD}, headers=elsewhere).status_code == 403
    assert client.post("/login", data={"password": PASSWORD}).status_code == 303
    assert client.post("/logout", headers=elsewhere).status_code == 403
    assert client.get("/session").status_code == 204


def test_a_forged_cookie_opens_nothing(client: httpx.Client) -> None:
    assert client.get("/session", headers={"Cookie": "atrium_session=operator.aaaa.bbbb"}).status_code == 401


def test_a_web_socket_needs_a_session_too(address: str) -> None:
    host, _, port = address.removeprefix("http://").partition(":")
    with socket.create_connection((host, int(port)), timeout=5) as raw:
        raw.sendall(
            b"GET /_nicegui_ws/socket.io/?EIO=4&transport=websocket HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\n"
            b"Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
        )
        assert raw.recv(100).startswith(b"HTTP/1.1 403")


def test_every_answer_forbids_other_hosts(client: httpx.Client) -> None:
    policy = client.get("/login").headers["content-security-policy"]
    assert "default-src 'self'" in policy
    assert "http:" not in policy
    assert "https:" not in policy


@pytest.mark.parametrize(
    "body", [b"", b"password", b"\xff\xfe", b"password=" + b"x" * 100_000, b"passwort=open+sesame"]
)
def test_a_form_that_is_none_is_refused(address: str, body: bytes) -> None:
    with _from("127.0.0.2", address) as own:
        headers = {"Content-Type": "application/x-www-form-urlencoded"}
        answer = own.post("/login", content=body, headers=headers)
        assert answer.status_code in (401, 429)


def test_guessing_is_stopped_but_not_for_others_nor_in_a_browser_that_is_known(address: str) -> None:
    with _from("127.0.0.3", address) as known:
        assert known.post("/login", data={"password": PASSWORD}).status_code == 303
        with _from("127.0.0.3", address) as guesser:
            statuses = [guesser.post("/login", data={"password": f"guess {n}"}).status_code for n in range(7)]
            assert statuses == [401] * 5 + [429] * 2
            refused = guesser.post("/login", data={"password": PASSWORD})
            assert refused.status_code == 429
            assert 1 <= int(refused.headers["retry-after"]) <= 30
            assert "seconds" in refused.text
        assert known.post("/login", data={"password": PASSWORD}).status_code == 303
    with httpx.Client(base_url=address, headers=HERE) as other:
        assert other.post("/login", data={"password": PASSWORD}).status_code == 303


def test_a_name_is_not_checked_here_and_without_the_api_nobody_is_blamed(client: httpx.Client) -> None:
    page = client.post("/login", data={"name": "maria", "password": PASSWORD})
    assert (page.status_code, "the API does not answer" in page.text) == (503, True)
    assert 'value="maria"' in page.text
