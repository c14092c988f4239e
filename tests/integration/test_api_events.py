"""Streams, alerts and webhooks as clients meet them: real bus, HTTP, WebSocket, database and receiver."""

import base64
import hashlib
import hmac
import json
import logging
import re
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
from api_in_process import running
from conftest import unused_port
from postgres_server import postgres
from test_api_live import DEADLINE, KEY, KEYS, alert, frame
from waiting import wait_until
from webhook_receiver import Receiver, receiver
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from services.api import request_body
from services.api.stream import DROPPED, READERS
from shared.bus import Bus, Publisher, router
from shared.keys import Keys
from shared.messages import Alert, Erasure, ErasureDone, Occupancy, TrackFrame
from shared.site import Site, load_site

TOLD_BY_ONE = "guard-key-for-alerts-1"
API_KEYS = json.dumps(
    ["demo-api-key", {"name": "guard", "key": TOLD_BY_ONE, "scopes": ["alerts"]}],
)


@pytest.fixture(scope="module")
def site(project: Path) -> Site:
    return load_site(project / "deploy/sites/hall/site.yaml")


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    at = f"tcp/127.0.0.1:{unused_port()}"
    broker = router(at)
    yield at
    broker.close()


@pytest.fixture(scope="module")
def bus(endpoint: str) -> Iterator[Bus]:
    with Bus([endpoint]) as opened:
        yield opened


@pytest.fixture(scope="module")
def address(site: Site, project: Path, endpoint: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    changes = {"webhook_networks": ["127.0.0.0/8"], "webhook_first_pause": 0.05, "webhook_attempts": 3}
    changes |= {"webhook_timeout": 1.0, "stream_rate": 100.0, "api_keys": API_KEYS}
    with running(site, project, endpoint, unused_port(), **changes) as at:
        yield at


@pytest.fixture(scope="module")
def alerts(bus: Bus) -> Publisher[Alert]:
    return bus.publisher(KEYS.alert("entrance"), Alert)


@pytest.fixture(scope="module")
def tracks(bus: Bus) -> Publisher[TrackFrame]:
    return bus.publisher(KEYS.tracks("hall"), TrackFrame)


class Lines:
    """Reads lines of JSON in the background, or what a WebSocket says."""

    def __init__(self, address: str, path: str, key: str = "demo-api-key") -> None:
        self.seen: list[dict[str, object]] = []
        self.silences = 0
        self.code: int | None = None
        """Close code of a WebSocket."""
        self._closing = threading.Event()
        self._headers = {"X-API-Key": key, "Accept": "application/x-ndjson"}
        self._url = address + path
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def of(self, event: str) -> list[dict[str, object]]:
        return [told["data"] for told in list(self.seen) if told["event"] == event]  # type: ignore[misc]

    @property
    def ended(self) -> bool:
        return not self._thread.is_alive()

    def close(self) -> None:
        self._closing.set()
        self._thread.join(DEADLINE)

    def _read(self) -> None:
        if self._url.startswith("ws"):
            with connect(self._url, additional_headers=self._headers, proxy=None) as opened:
                while not self._closing.is_set():
                    try:
                        self.seen.append(json.loads(opened.recv(timeout=0.1)))
                    except TimeoutError:
                        self.silences += 1
                    except ConnectionClosed:
                        break
            self.code = opened.close_code
            return
        with httpx.stream("GET", self._url, headers=self._headers, timeout=DEADLINE) as reply:
            assert reply.headers["Content-Type"].startswith("application/x-ndjson")
            for line in reply.iter_lines():
                if line:
                    self.seen.append(json.loads(line))
                else:
                    self.silences += 1
                if self._closing.is_set():
                    return


def test_every_form_of_the_stream_tells_the_same_events_under_the_same_ids(
    address: str, bus: Bus, alerts: Publisher[Alert], tracks: Publisher[TrackFrame]
) -> None:
    sockets = address.replace("http", "ws")
    readers = [Lines(address, "/v1/stream"), Lines(address, "/v1/events"), Lines(sockets, "/v1/ws")]
    some = [
        Lines(address, "/v1/events?kinds=alert&zone=entrance"),
        Lines(address, "/v1/events?zone=model-corner"),
        Lines(sockets, "/v1/ws?device=phone-1&kinds=tracks"),
        Lines(address, "/v1/events", TOLD_BY_ONE),
    ]
    wait_until(lambda: all(each.silences for each in [*readers, *some]), DEADLINE, "all streams to be open")
    counts = bus.publisher(KEYS.occupancy(), Occupancy)
    number = 0

    def told() -> bool:
        nonlocal number
        number += 1
        tracks.publish(frame(time.time(), chunk=number))
        counts.publish(Occupancy(t=1.0, zone=["entrance"], people=[number], phones=[0]))
        alerts.publish(alert(100 + number))
        return all(len(each.of(kind)) >= 3 for each in readers for kind in ("tracks", "alert", "occupancy"))

    wait_until(told, DEADLINE, "three events of each kind for everybody")
    last = alert(100 + number).id
    for each in readers:
        wait_until(lambda each=each: last in [a["id"] for a in each.of("alert")], DEADLINE, "the last alert")
    every = {told["id"]: told for told in readers[0].seen if told["id"] is not None and told["event"] == "alert"}
    for each in readers[1:]:
        assert {e["id"]: e for e in each.seen if e["event"] == "alert" and e["id"] is not None} == every
    ids = [told["id"] for told in readers[1].seen if told["id"] is not None]
    assert ids == sorted(set(ids)), "unique and in order"
    wait_until(lambda: len(some[0].seen) == number, DEADLINE, "the alerts of one zone")
    assert {told["event"] for told in some[0].seen} == {"alert"}
    assert {told["event"] for told in some[1].seen} == {"tracks"}
    assert all(told["track"] == [] for told in some[1].of("tracks")), "nobody is there"
    wait_until(lambda: some[2].seen, DEADLINE, "rows of one device")
    assert {tuple(told["device"]) for told in some[2].of("tracks")} == {("phone-1",)}  # type: ignore[arg-type]
    assert {told["event"] for told in some[3].seen} == {"alert"}, "what the key may not be told is left out"
    for each in [*readers, *some]:
        each.close()


def test_a_stream_resumes_without_loss_or_says_that_it_cannot(
    address: str, alerts: Publisher[Alert], tracks: Publisher[TrackFrame]
) -> None:
    first = Lines(address, "/v1/events?from=oldest")

    def begun() -> bool:
        tracks.publish(frame(time.time()))
        return len(first.of("tracks")) > 5

    wait_until(begun, DEADLINE, "a few events")
    first.close()
    cut = first.seen[2]["id"]
    alerts.publish(alert(201))
    again = Lines(address, f"/v1/stream?from={cut}")
    wait_until(lambda: "a-201" in [a["id"] for a in again.of("alert")], DEADLINE, "what came since")
    ids = [int(str(told["id"])) for told in again.seen]
    assert ids == list(range(int(str(cut)) + 1, ids[-1] + 1)), "every event, none twice"
    again.close()
    for wrong, status in (("1", 410), ("9" * 17, 410), ("yesterday", 422), ("9" * 40, 422), ("²", 422)):
        refused = httpx.get(f"{address}/v1/events", params={"from": wrong}, headers=KEY)
        assert (refused.status_code, refused.json()["field"]) == (status, "from")
    assert "begin anew" in httpx.get(f"{address}/v1/events?from=1", headers=KEY).json()["detail"]
    with httpx.stream("GET", f"{address}/v1/stream?kinds=alert", headers=KEY | {"Last-Event-ID": "1"}) as reply:
        text = next(chunk for chunk in reply.iter_text() if "event" in chunk)
    assert "event: lost" in text, "a browser comes back by itself and is told that something is missing"


def test_alerts_are_resumed_over_a_restart_and_the_rest_is_told_to_be_lost(
    site: Site, project: Path, endpoint: str, tmp_path: Path, bus: Bus
) -> None:
    kept = {"api_database_url": f"sqlite:///{tmp_path / 'api.db'}"}
    told = bus.publisher(KEYS.alert("model-corner"), Alert, cached=True, history=10)
    with running(site, project, endpoint, unused_port(), **kept) as address:
        listening = Lines(address, "/v1/events?kinds=alert&zone=model-corner")
        wait_until(lambda: listening.silences, DEADLINE, "the stream")
        for number in (801, 802, 803):
            told.publish(alert(number, "model-corner"))
        wait_until(lambda: len(listening.seen) == 3, DEADLINE, "three alerts")
        listening.close()
        written = f"{address}/v1/alerts/a-803"
        wait_until(lambda: httpx.get(written, headers=KEY).status_code == 200, DEADLINE, "the last in the inbox")
    first = listening.seen[0]["id"]
    told.publish(alert(804, "model-corner"))
    with running(site, project, endpoint, unused_port(), **kept) as address:
        again = Lines(address, f"/v1/events?kinds=alert&zone=model-corner&from={first}")
        wait_until(lambda: len(again.seen) == 3, DEADLINE, "two from the database, one told while the API was away")
        assert again.seen[:2] == listening.seen[1:]
        assert [one["id"] for one in again.of("alert")] == ["a-802", "a-803", "a-804"]
        again.close()
        for last in (str(first), "a-801"):
            headers = KEY | {"Last-Event-ID": last}
            text = ""
            with httpx.stream("GET", f"{address}/v1/stream?zone=model-corner", headers=headers) as reply:
                for chunk in reply.iter_text():
                    text += chunk
                    if "a-804" in text:
                        break
            assert re.findall(r'"id":"(a-80.)"', text) == ["a-802", "a-803", "a-804"]
            assert "event: lost" in text
        assert httpx.get(f"{address}/v1/events?from={first}", headers=KEY).status_code == 410


def test_bad_questions_to_streams_are_refused_in_every_form(address: str) -> None:
    for query, status, field in (
        ("area=nowhere", 404, "area"),
        ("zone=nowhere", 404, "zone"),
        ("near=1,2", 422, "near"),
        ("confidence=2", 422, "confidence"),
        ("device=%00", 422, "device"),
        ("kinds=alert,rumour", 422, "kinds"),
        ("kinds=", 422, "kinds"),
    ):
        for path in ("stream", "events"):
            refused = httpx.get(f"{address}/v1/{path}?{query}", headers=KEY)
            assert (refused.status_code, refused.json()["field"]) == (status, field)
        with pytest.raises(InvalidStatus) as socket_refused:
            connect(f"{address.replace('http', 'ws')}/v1/ws?{query}", additional_headers=KEY, proxy=None)
        assert socket_refused.value.response.status_code == status
        assert json.loads(socket_refused.value.response.body)["field"] == field
    for key, status in (({}, 401), ({"X-API-Key": "wrong"}, 401)):
        with pytest.raises(InvalidStatus) as nobody:
            connect(f"{address.replace('http', 'ws')}/v1/ws", additional_headers=key, proxy=None)
        assert nobody.value.response.status_code == status
    refused = httpx.get(f"{address}/v1/events?kinds=tracks", headers={"X-API-Key": TOLD_BY_ONE})
    assert (refused.status_code, refused.json()["allowed"]) == (403, "a key with the scope positions")


@contextmanager
def idle_client(port: int, path: str) -> Iterator[None]:
    """A client that asks for a stream and reads nothing of it."""
    with socket.socket() as idle:
        idle.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        idle.connect(("127.0.0.1", port))
        lines = [f"GET {path} HTTP/1.1", "Host: x", "X-API-Key: demo-api-key"]
        if path == "/v1/ws":
            lines += ["Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13"]
            lines += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="]
        idle.sendall("\r\n".join([*lines, "", ""]).encode())
        yield


@pytest.mark.parametrize("people", [1000, 3], ids=["much-waits-in-the-service", "little-waits-in-the-system"])
@pytest.mark.parametrize("path", ["/v1/stream", "/v1/ws"])
def test_a_client_that_reads_nothing_is_dropped_and_counted_and_others_are_told(
    path: str, people: int, site: Site, project: Path, endpoint: str, tracks: Publisher[TrackFrame]
) -> None:
    port = unused_port()
    stalled, before = DROPPED.labels("stalled")._value, READERS._value.get()
    dropped = stalled.get()
    with (
        running(site, project, endpoint, port, stream_rate=100.0, stream_patience=0.5) as address,
        idle_client(port, path),
    ):
        attentive = Lines(address, "/v1/events")

        def crowd() -> bool:
            tracks.publish(frame(time.time(), people=people))
            return stalled.get() > dropped

        wait_until(crowd, DEADLINE, "the idle client to be dropped")
        assert stalled.get() == dropped + 1
        wait_until(lambda: READERS._value.get() == before + 1, DEADLINE, "its reader to be forgotten")
        seen = len(attentive.seen)
        wait_until(lambda: crowd() and len(attentive.seen) > seen, DEADLINE, "others to be told")
        attentive.close()


def test_half_a_request_is_not_waited_for_and_hanging_up_is_no_error(
    address: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(request_body, "PATIENCE", 0.3)
    lines = ["POST /v1/zones HTTP/1.1", "Host: x", "X-API-Key: demo-api-key", "Content-Length: 100", "", '{"id":']
    there = ("127.0.0.1", int(address.rpartition(":")[2]))
    with socket.create_connection(there, DEADLINE) as gone, socket.create_connection(there, DEADLINE) as slow:
        for one in (gone, slow):
            one.sendall("\r\n".join(lines).encode())
        gone.close()
        told = b"".join(iter(lambda: slow.recv(4096), b""))
    assert told.startswith(b"HTTP/1.1 408 ")
    assert json.loads(told.partition(b"\r\n\r\n")[2])["field"] == "body"
    assert [record for record in caplog.records if record.levelno >= logging.ERROR] == []


def test_the_inbox_says_who_looked_and_everybody_who_listens_hears_it(address: str, alerts: Publisher[Alert]) -> None:
    listening = Lines(address, "/v1/events?kinds=acknowledged")
    wait_until(lambda: listening.silences, DEADLINE, "the stream")
    alerts.publish(alert(301))
    url = f"{address}/v1/alerts/a-301"
    wait_until(lambda: httpx.get(url, headers=KEY).status_code == 200, DEADLINE, "the alert in the inbox")
    note = "a school class; <script>'); DROP TABLE api_alerts; --"
    seen = httpx.post(f"{url}/acknowledge", headers=KEY, json={"note": note}).json()["acknowledged"]
    assert (seen["by"], seen["note"]) == ("key-1", note)
    second = httpx.post(f"{url}/acknowledge", headers=KEY)
    assert (second.status_code, second.json()["detail"]) == (409, "key-1 acknowledged this alert before")
    (told,) = wait_until(lambda: listening.of("acknowledged"), DEADLINE, "the acknowledgement on the stream")
    assert told == {"id": "a-301", "acknowledged": seen}
    listening.close()
    may_not = httpx.post(f"{url}/acknowledge", headers={"X-API-Key": TOLD_BY_ONE})
    assert (may_not.status_code, may_not.json()["allowed"]) == (403, "a key with the scope acknowledge")
    page = httpx.get(f"{address}/v1/alerts?acknowledged=true&limit=1&kinds=enter,exit&area=hall", headers=KEY).json()
    assert ([one["id"] for one in page["alerts"]], page["next"]) == (["a-301"], None)
    pages, seen_ids = 0, list[str]()
    query = "?limit=2"
    while query:
        page = httpx.get(f"{address}/v1/alerts{query}", headers=KEY).json()
        seen_ids += [one["id"] for one in page["alerts"]]
        query, pages = f"?limit=2&before={page['next']}" if page["next"] else "", pages + 1
    assert len(seen_ids) == len(set(seen_ids)) > 2 < 2 * pages
    for path, status, field in (
        ("?kinds=rumour", 422, "kinds"),
        ("?before=forgotten", 404, "before"),
        ("?until=nan", 422, "until"),
        ("?device=no%20device", 404, "device"),
        ("?acknowledged=perhaps", 422, "acknowledged"),
        ("/forgotten", 404, "alert"),
        ("/%00", 404, "alert"),
    ):
        refused = httpx.get(f"{address}/v1/alerts{path}", headers=KEY)
        assert (refused.status_code, refused.json()["field"]) == (status, field), path
    for body, field in (({"note": 1}, "note"), ({"note": "x" * 2001}, "note"), ({"by": "me"}, "by"), ([], "body")):
        refused = httpx.post(f"{url}/acknowledge", headers=KEY, json=body)
        assert (refused.status_code, refused.json()["field"]) == (422, field)


def test_a_withdrawn_device_leaves_the_inbox_and_that_is_acknowledged(
    address: str, bus: Bus, alerts: Publisher[Alert]
) -> None:
    import msgspec

    alerts.publish(msgspec.structs.replace(alert(401), device="p-gone", other_device="p-stays"))
    asked = {"device": "p-gone"}
    url = f"{address}/v1/alerts"
    wait_until(lambda: httpx.get(url, params=asked, headers=KEY).json()["alerts"], DEADLINE, "the alert in the inbox")
    heard = bus.inbox()
    heard.subscribe(Keys("hall").erased("p-gone"), ErasureDone)
    bus.publisher(KEYS.erasure("p-gone"), Erasure).publish(Erasure(t=1.0, device="p-gone"))
    (done,) = heard.receive(timeout=DEADLINE)
    assert (done.message.device, done.message.service) == ("p-gone", "api")  # type: ignore[attr-defined]
    assert httpx.get(url, params=asked, headers=KEY).json()["alerts"] == []
    assert httpx.get(f"{url}/a-401", headers=KEY).json()["other_device"] == "p-stays"
    with httpx.stream("GET", f"{address}/v1/events?from=oldest", headers=KEY) as reply:
        held = ""
        for chunk in reply.iter_text():
            held += chunk
            if "p-stays" in held:
                break
    assert "p-gone" not in held


@pytest.fixture
def outside() -> Iterator[Receiver]:
    with receiver() as one:
        yield one


def webhook(address: str, url: str, **more: object) -> dict[str, object]:
    answer = httpx.post(f"{address}/v1/webhooks", headers=KEY, json={"url": url, **more})
    assert answer.status_code == 201, answer.text
    made: dict[str, object] = answer.json()
    assert answer.headers["Location"] == f"/v1/webhooks/{made['id']}"
    return made


def test_webhooks_are_signed_tried_again_given_up_and_replayed_and_the_slow_hold_up_nobody(
    address: str, alerts: Publisher[Alert], outside: Receiver
) -> None:
    open_again = threading.Event()

    def answer(path: str) -> int:
        if path == "/slow":
            open_again.wait(DEADLINE)
        return 500 if path == "/broken" and not open_again.is_set() else 302 if path == "/elsewhere" else 204

    outside.answer, outside.location = answer, f"{outside.url}/good"
    hooks = {name: webhook(address, f"{outside.url}/{name}") for name in ("slow", "broken", "elsewhere", "good")}
    for number in range(501, 511):
        alerts.publish(alert(number))

    def of(path: str) -> list[dict[str, str]]:
        return [headers for at, headers, _ in list(outside.taken) if at == path]

    wait_until(lambda: len(of("/good")) >= 10, DEADLINE, "the good receiver to get them all, whatever others do")
    assert not open_again.is_set()
    _, headers, body = next(each for each in outside.taken if each[0] == "/good")
    key = base64.b64decode(str(hooks["good"]["secret"]).removeprefix("whsec_"))
    signed = f"{headers['webhook-id']}.{headers['webhook-timestamp']}.".encode() + body
    expected = base64.b64encode(hmac.digest(key, signed, hashlib.sha256)).decode()
    assert headers["webhook-signature"] == f"v1,{expected}"
    assert (json.loads(body)["id"], json.loads(body)["site"]) == (headers["webhook-id"], "hall")

    def state(name: str) -> dict[str, object]:
        now: dict[str, object] = httpx.get(f"{address}/v1/webhooks/{hooks[name]['id']}", headers=KEY).json()
        return now

    wait_until(lambda: state("broken")["dead"] == 10, DEADLINE, "ten alerts to be given up after three attempts each")
    assert (state("broken")["failed"], state("broken")["last_reason"]) == (30, "answered 500")
    wait_until(lambda: state("slow")["failed"], DEADLINE, "a slow receiver to time out")
    assert "no answer within 1 s" in str(state("slow")["last_reason"])
    wait_until(lambda: state("elsewhere")["dead"] == 10, DEADLINE, "redirects to be given up")
    assert len(of("/good")) == 10, "and never followed"
    assert "redirects are not followed" in str(state("elsewhere")["last_reason"])
    dead = f"{address}/v1/webhooks/{hooks['broken']['id']}/dead"
    page = httpx.get(f"{dead}?limit=4", headers=KEY).json()
    rest = httpx.get(f"{dead}?after={page['next']}", headers=KEY).json()
    assert (len(page["dead"]), len(rest["dead"]), rest["next"]) == (4, 6, None)
    assert page["dead"][0]["reason"] == "answered 500"
    open_again.set()
    replay = f"{address}/v1/webhooks/{hooks['broken']['id']}/replay"
    assert httpx.post(f"{replay}?letter={page['dead'][0]['id']}", headers=KEY).json() == {"replayed": 1}
    assert httpx.post(replay, headers=KEY).json() == {"replayed": 9}
    wait_until(lambda: state("broken")["delivered"] == 10, DEADLINE, "the replayed ones to be taken")
    messages = [each["webhook-id"] for each in of("/broken")]
    assert len(set(messages)) == 10, "a message that comes again has the id it had"
    listed = httpx.get(f"{address}/v1/webhooks", headers=KEY).json()["webhooks"]
    assert "secret" not in listed[0]
    for hook in listed:
        assert httpx.delete(f"{address}/v1/webhooks/{hook['id']}", headers=KEY).status_code == 204
    assert httpx.get(f"{address}/v1/webhooks", headers=KEY).json()["webhooks"] == []


def test_webhooks_that_nobody_should_make_are_refused(address: str) -> None:
    for body, field in (
        ({"url": "http://10.0.0.1/"}, "url"),
        ({"url": "https://169.254.169.254/latest/meta-data"}, "url"),
        ({"url": "https://[::1]/"}, "url"),
        ({"url": "file:///etc/passwd"}, "url"),
        ({"url": "https://no-such-host.invalid/"}, "url"),
        ({"url": "x" * 2001}, "url"),
        ({"name": "no url"}, "url"),
        ({"url": "http://127.0.0.1/", "kinds": ["rumour"]}, "kinds[0]"),
        ({"url": "http://127.0.0.1/", "zones": ["'; DROP TABLE api_webhooks; --"]}, "zones[0]"),
        ({"url": "http://127.0.0.1/", "secret": "mine"}, "secret"),
        ([], "body"),
    ):
        refused = httpx.post(f"{address}/v1/webhooks", headers=KEY, json=body)
        assert (refused.status_code, refused.json()["field"]) == (422, field), refused.text
    missing = httpx.get(f"{address}/v1/webhooks/wh-1", headers=KEY)
    assert (missing.status_code, missing.json()["field"]) == (404, "webhook")
    refused = httpx.get(f"{address}/v1/webhooks", headers={"X-API-Key": TOLD_BY_ONE})
    assert (refused.status_code, refused.json()["allowed"]) == (403, "a key with the scope webhooks")


def test_what_a_receiver_has_not_taken_is_sent_after_a_restart(
    site: Site, project: Path, endpoint: str, tmp_path: Path, alerts: Publisher[Alert], outside: Receiver
) -> None:
    kept = {"api_database_url": f"sqlite:///{tmp_path / 'alerts.db'}", "webhook_networks": ["127.0.0.0/8"]}
    kept |= {"webhook_first_pause": 0.5}
    outside.answer = lambda _: 503
    with running(site, project, endpoint, unused_port(), **kept) as address:
        webhook(address, f"{outside.url}/alarm")
        alerts.publish(alert(601))
        wait_until(lambda: outside.taken, DEADLINE, "a first attempt")
    outside.answer = lambda _: 200
    before = len(outside.taken)
    with running(site, project, endpoint, unused_port(), **kept) as address:
        wait_until(lambda: len(outside.taken) > before, DEADLINE, "another attempt")
        assert httpx.get(f"{address}/v1/alerts/a-601", headers=KEY).status_code == 200
        assert {headers["webhook-id"] for _, headers, _ in outside.taken} == {outside.taken[0][1]["webhook-id"]}


def test_a_database_that_goes_away_loses_no_alert_and_holds_up_no_stream(
    site: Site, project: Path, endpoint: str, alerts: Publisher[Alert], outside: Receiver
) -> None:
    with (
        postgres() as server,
        running(
            site, project, endpoint, unused_port(), api_database_url=server.url, webhook_networks=["127.0.0.0/8"]
        ) as address,
    ):
        webhook(address, f"{outside.url}/alarm")
        listening = Lines(address, "/v1/events?kinds=alert")
        wait_until(lambda: listening.silences, DEADLINE, "the stream")
        server.stop()
        alerts.publish(alert(701))
        wait_until(lambda: listening.of("alert"), DEADLINE, "the alert on the stream")
        for path in ("alerts", "webhooks"):
            away = httpx.get(f"{address}/v1/{path}", headers=KEY, timeout=DEADLINE)
            assert (away.status_code, away.headers["Retry-After"]) == (503, "5")
            assert away.json()["type"] == "urn:atrium:database-away"
        assert httpx.get(f"{address}/v1/positions", headers=KEY).status_code == 200
        server.start()
        url = f"{address}/v1/alerts/a-701"
        wait_until(lambda: httpx.get(url, headers=KEY, timeout=DEADLINE).status_code == 200, DEADLINE, "the alert")
        wait_until(lambda: outside.taken, DEADLINE, "the webhook")
        listening.close()


def test_a_stream_ends_with_its_key_in_every_form_and_says_why(address: str) -> None:
    wanted = {"name": "guide-app", "scopes": ["positions"]}
    soon = {"expires": time.time() + 1.0}
    for last, path in ((soon, "/v1/events"), ({}, "/v1/events"), ({}, "/v1/ws")):
        made = httpx.post(f"{address}/v1/keys", headers=KEY, json=wanted | last).json()
        listening = Lines(address if path != "/v1/ws" else address.replace("http", "ws"), path, made["key"])
        wait_until(lambda: listening.silences or listening.seen, DEADLINE, "the stream")  # noqa: B023
        if not last:
            httpx.delete(f"{address}/v1/keys/{made['id']}", headers=KEY)
        asked = time.monotonic()
        wait_until(lambda: listening.ended, DEADLINE, "its end")  # noqa: B023
        assert time.monotonic() - asked < 5.0
        assert [one["type"] for one in listening.of("ended")] == ["urn:atrium:unauthorized"]
        assert httpx.get(f"{address}{path}", headers={"X-API-Key": made["key"]}).status_code in (401, 404)
    assert listening.code == 1008
