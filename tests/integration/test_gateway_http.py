"""Phones against the real gateway: its own process, real HTTP, a real router."""

import json
import math
import socket
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import httpx
import msgspec
import pytest
from api_in_process import running as running_api
from gateway_process import KEY, STAFF, Listener, Phone, Running, finish, is_ready, launch, problem, running_gateway
from history_in_process import running as running_history
from history_world import frame
from waiting import wait_until

from services.api.pseudonyms import ERASED
from services.gateway.devices.own_alerts import OwnAlertBook
from services.gateway.devices.own_past import OwnPast
from services.gateway.protocol import OwnExport
from services.history.database import migrate
from shared.bus import router
from shared.messages import Alert, TrackFrame
from shared.site import load_site
from shared.zones import ZoneSet


@pytest.fixture(scope="module")
def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with running_gateway(tmp_path_factory.mktemp("gateway")) as running:
        yield running


@pytest.fixture(scope="module")
def listener(gateway: Running) -> Iterator[Listener]:
    listening = Listener(gateway.endpoint)
    yield listening
    listening.bus.close()


@pytest.mark.parametrize("clock", [0.0, 86_400.0])
def test_what_a_phone_posts_arrives_on_the_bus_in_server_time(
    gateway: Running, listener: Listener, clock: float
) -> None:
    phone = Phone(gateway, clock)
    wait_until(lambda: phone.http.get("/docs").status_code == 200, 20, "the page")
    for seq in range(12):
        answer = phone.post(phone.batch(seq))
        assert answer.status_code == 200, answer.text
        reply = answer.json()
        assert reply["accepted"]["samples"] == 50
        assert reply["accepted"]["readings"] == 2
        assert reply["ignored"] == {"unknown address": 1}
        assert reply["received"] <= reply["replied"]
        assert reply["clock_offset"] == pytest.approx(-clock, abs=0.5)
    wait_until(lambda: len(listener.heard(phone.device)[0]) == 12, 10, "12 scans")
    scans, motions = listener.heard(phone.device)
    assert scans[0].access_point == ["ap-1", "ap-2"]
    assert scans[0].t == pytest.approx(phone.start + 0.5, abs=0.5)
    assert all("de:ad" not in repr(message) for message in listener.messages)
    steps = [step for motion in motions for step in motion.step_t]
    assert 16 <= len(steps) <= 24
    assert all(phone.start - 0.5 < step < phone.start + 12.5 for step in steps)
    headings = [heading for motion in motions for heading in motion.heading]
    assert all(abs(heading) < 0.1 for heading in headings)  # east is the plan's +x


def test_a_batch_sent_again_is_acknowledged_and_published_once(gateway: Running, listener: Listener) -> None:
    phone = Phone(gateway)
    batch = phone.batch(0)
    assert phone.post(batch).json()["duplicate"] is False
    assert phone.post(batch).json()["duplicate"] is True
    phone.post(phone.batch(1))
    wait_until(lambda: len(listener.heard(phone.device)[0]) >= 2, 10, "both scans")
    assert [scan.seq for scan in listener.heard(phone.device)[0]] == [0, 1]


def test_bad_bodies_are_refused_by_name_and_publish_nothing(gateway: Running, listener: Listener) -> None:
    phone = Phone(gateway)
    good = phone.batch(0)
    text = json.dumps(good)
    nan = good | {"imu": good["imu"] | {"ax": [math.nan] * 50}}
    ahead = good | {"imu": good["imu"] | {"t": [stamp + 86_400 for stamp in good["imu"]["t"]]}}
    cases: list[tuple[Any, int, str]] = [
        ({"sent": 1.0, "seq": 0}, 422, "body"),
        (nan, 422, "imu.ax[0]"),
        (ahead, 422, "imu.t[0]"),
        (good | {"imu": good["imu"] | {"ax": [1.0]}}, 422, "imu.ax"),
        (b"not json", 400, "body"),
        (b"\xff\xfe", 400, "body"),
        (b"", 400, "body"),
        (b"x" * 10_000_000, 413, "body"),
        (text.replace('"seq"', '"sequence"').encode(), 422, "seq"),
    ]
    for body, status, field in cases:
        answer = phone.post(body)
        assert (answer.status_code, problem(answer)["field"]) == (status, field), answer.text
    assert phone.post(b"x", **{"Content-Encoding": "br"}).status_code == 415
    assert phone.post(good).json()["duplicate"] is False
    wait_until(lambda: listener.heard(phone.device)[0], 10, "the one good batch")
    assert len(listener.heard(phone.device)[0]) == 1


def test_a_huge_body_without_a_length_is_refused_while_it_comes(gateway: Running) -> None:
    phone = Phone(gateway)
    chunks = (b" " * 65_536 for _ in range(160))
    answer = phone.http.post(phone.enrolled["batches"], content=chunks, headers=phone.headers)
    assert (answer.status_code, problem(answer)["field"]) == (413, "body")


def test_a_body_that_claims_a_terabyte_is_refused_unread(gateway: Running) -> None:
    phone = Phone(gateway)
    with socket.create_connection(("127.0.0.1", gateway.http.base_url.port or 0), timeout=5) as line:
        head = f"POST {phone.enrolled['batches']} HTTP/1.1\r\nHost: x\r\nContent-Length: 1099511627776\r\n"
        line.sendall(f"{head}Authorization: {phone.headers['Authorization']}\r\n\r\n{'x' * 1000}".encode())
        assert b" 413 " in line.recv(4096).split(b"\r\n")[0]


def test_tokens_open_their_own_device_only_and_are_looked_at_first(gateway: Running) -> None:
    mine, other = Phone(gateway), Phone(gateway)
    for method, path in (("POST", "/batches"), ("GET", "/position"), ("DELETE", "")):

        def ask(
            device: str, headers: dict[str, str], method: str = method, path: str = path
        ) -> tuple[int, dict[str, str]]:
            answer = mine.http.request(method, f"/v1/devices/{device}{path}", headers=headers)
            return answer.status_code, problem(answer)

        assert ask(mine.device, {})[0] == 401
        assert ask(mine.device, {"Authorization": "Bearer wrong"})[0] == 401
        assert ask(mine.device, {"Authorization": "Basic wrong"})[0] == 401
        assert ask("d-nobody", {"Authorization": "Bearer wrong"}) == ask(mine.device, {"Authorization": "Bearer wrong"})
        assert ask(other.device, mine.headers)[0] == 403
        assert ask("d-nobody", mine.headers)[0] == 404


def test_enrolment_needs_the_key_and_consent(gateway: Running) -> None:
    good = {"enrolment_key": KEY, "consent": True}
    cases: list[tuple[Any, int, str]] = [
        (good | {"consent": False}, 422, "consent"),
        ({"enrolment_key": KEY}, 422, "consent"),
        (good | {"consent": "yes"}, 422, "consent"),
        (good | {"carrying": "in my hat"}, 422, "carrying"),
        (good | {"name": "x" * 100}, 422, "name"),
        (good | {"enrolment_key": "wrong"}, 403, "enrolment_key"),
        (good | {"name": "x" * 100_000}, 413, "body"),
    ]
    for body, status, field in cases:
        answer = gateway.http.post("/v1/devices", json=body)
        assert (answer.status_code, problem(answer)["field"]) == (status, field), answer.text


def test_the_qr_code_is_for_staff(gateway: Running) -> None:
    for headers in ({}, {"Authorization": "Bearer wrong-one"}, {"Authorization": "Basic !!"}):
        assert gateway.http.get("/v1/enrolment.svg", headers=headers).status_code == 401
    answer = gateway.http.get("/v1/enrolment.svg", headers={"Authorization": f"Bearer {STAFF}"})
    assert answer.headers["content-type"] == "image/svg+xml"
    assert gateway.http.get("/v1/enrolment.svg", auth=("staff", KEY)).status_code == 200
    scanned = json.dumps({"atrium": 1, "url": str(gateway.http.base_url), "enrolment_key": KEY})
    answer = gateway.http.post("/v1/devices", json={"enrolment_key": scanned, "consent": True})
    assert answer.status_code == 201


def test_a_phone_reads_its_own_position_once_a_track_carries_it(gateway: Running, listener: Listener) -> None:
    phone = Phone(gateway)
    answer = phone.http.get(phone.enrolled["position"], headers=phone.headers)
    assert answer.status_code == 404
    assert problem(answer)["problem"] == "not located yet: no camera track carries this device"
    now = time.time()
    columns: dict[str, Any] = {"state": ["confirmed"], "runner_up": [None], "runner_up_probability": [0.0]}
    frame = TrackFrame(
        t=now,
        area="hall",
        chunk=1,
        tracker="test",
        track=[1],
        floor=["ground"],
        x=[7.0],
        y=[3.0],
        covariance=[(0.1, 0.0, 0.1)],
        vx=[0.0],
        vy=[0.0],
        device=[phone.device],
        probability=[0.9],
        former=[[]],
        sources=[[]],
        quality=[1.0],
        **columns,
    )
    publisher = listener.bus.publisher(listener.keys.tracks("hall"), TrackFrame)

    def found() -> dict[str, Any] | None:
        publisher.publish(frame)
        answer = phone.http.get(phone.enrolled["position"], headers=phone.headers)
        return answer.json() if answer.status_code == 200 else None

    position = wait_until(found, 10, "the position")
    assert position is not None
    assert (position["x"], position["y"], position["floor"], position["area"]) == (7.0, 3.0, "ground", "hall")
    assert 0.0 <= position["age"] < 10.0
    assert position["t"] == pytest.approx(now)


def test_a_visitor_takes_away_all_that_is_stored_of_them(
    gateway: Running, listener: Listener, project: Path, tmp_path: Path
) -> None:
    phone, other = Phone(gateway), Phone(gateway)
    own = f"/v1/devices/{phone.device}"
    record = phone.http.get(own, headers=phone.headers).json()
    assert (record["platform"], record["carrying"], record["tokens"]) == ("test", "hand", 1)
    assert [consent["version"] for consent in record["consents"]] == ["1"]
    kept = {row["what"]: row["seconds"] for row in record["kept"] if row["service"] == "gateway"}
    assert kept["that a phone's token is valid"] == 7 * 86400.0
    assert record["silent"] == ["history", "learning"], "what is missing is said"
    away = phone.http.get(f"{own}/export", headers=phone.headers)
    assert (away.status_code, problem(away)["problem"]) == (503, "history does not answer")
    assert phone.http.get(f"{own}/export", headers=other.headers).status_code == 403
    migrate(f"sqlite:///{tmp_path / 'history.db'}")
    with running_history(load_site(project / "deploy/sites/hall/site.yaml"), project, gateway.endpoint, tmp_path):
        tracks = listener.bus.publisher(listener.keys.tracks("hall"), TrackFrame)
        past, since = OwnPast(listener.bus, listener.keys, OwnAlertBook([], 1.0).told), time.time()
        about = {"device": other.device, "other_device": phone.device, "zone": "entrance", "kind": "proximity"}
        where = {"area": "hall", "floor": "ground", "track": 1, "x": 7.0, "y": 3.0}
        met = Alert(t=since, id="met-1", **about, **where)  # type: ignore[arg-type]
        told = listener.bus.publisher(listener.keys.alert("entrance"), Alert, cached=True)
        told.publish(met)

        def points() -> int:
            now = time.time()
            tracks.publish(frame(now, [(1, 7.0, 3.0, phone.device), (2, 9.0, 3.0, other.device)]))
            return sum(len(way.t) * len(way.alerts) for way in past.ways(phone.device, since, now))

        wait_until(points, 15, "history to know way and alert")
        taken = phone.http.get(f"{own}/export", headers=phone.headers)
    assert taken.headers["Content-Disposition"] == f'attachment; filename="atrium-{phone.device}.json"'
    everything = msgspec.json.decode(taken.content, type=OwnExport)
    (way,) = everything.ways
    assert way.t
    assert {(x, y, floor) for x, y, floor in zip(way.x, way.y, way.floor, strict=True)} == {(7.0, 3.0, "ground")}
    assert [alert.kind for alert in way.alerts] == ["proximity"]
    assert everything.record.device == phone.device
    assert other.device not in taken.text
    wait_until(lambda: phone.http.get(own, headers=phone.headers).status_code == 429, 60, "the ration to be used up")


def test_withdrawn_consent_ends_everything_at_once(gateway: Running, listener: Listener) -> None:
    phone = Phone(gateway)
    assert phone.post(phone.batch(0)).status_code == 200
    assert phone.http.delete(f"/v1/devices/{phone.device}", headers=phone.headers).status_code == 204
    wait_until(lambda: phone.device in listener.erased(), 10, "everybody to be told whom to forget")
    assert phone.post(phone.batch(1)).status_code == 401
    assert phone.http.get(phone.enrolled["position"], headers=phone.headers).status_code == 401
    assert phone.http.delete(f"/v1/devices/{phone.device}", headers=phone.headers).status_code == 401


def test_staff_erase_a_phone_everywhere_for_a_visitor(
    gateway: Running, listener: Listener, project: Path, free_port: int
) -> None:
    phone = Phone(gateway)
    with running_api(
        load_site(project / "deploy/sites/hall/site.yaml"), project, gateway.endpoint, free_port
    ) as address:
        staff = httpx.Client(base_url=address, headers={"Authorization": "Bearer demo-api-key"}, timeout=15.0)
        told = listener.bus.inbox()
        told.subscribe(listener.keys.zones(), ZoneSet, cached=True)
        only = {"id": "only", "kind": "enter", "devices": [phone.device]}
        zone = {"id": "vault", "floor": "ground", "points": [[1, 6], [4, 6], [4, 9]], "rules": [only]}
        assert staff.post("/v1/zones", json=zone).status_code == 201
        assert staff.put("/v1/zones/vault", json=zone | {"name": "After"}).status_code == 200
        assert staff.get("/v1/alerts", params={"device": phone.device}).status_code == 200
        assert staff.delete("/v1/devices/d-of-nobody").status_code == 404
        answer = staff.delete(f"/v1/devices/{phone.device}")
        assert (answer.status_code, answer.json()["device"]) == (202, phone.device)
        assert phone.post(phone.batch(0)).status_code == 401, "its token is dead at once"

        def row() -> dict[str, Any] | None:
            rows = staff.get("/v1/erasures").json()["erasures"]
            return next((row for row in rows if row["device"] == phone.device and row["done"]), None)

        done = wait_until(row, 10, "the API to say that nothing of the phone is left in it")
        assert done is not None
        assert ([store["service"] for store in done["done"]], done["waiting"]) == (
            ["api"],
            ["fusion-hall", "geofence", "history", "learning"],
        )
        again = staff.delete(f"/v1/devices/{phone.device}")
        assert (again.status_code, again.json()["t"]) == (202, answer.json()["t"]), "asked twice is done once"
        kept = staff.get("/v1/audit").text + staff.get("/v1/zones").text
        assert phone.device not in kept
        assert [e["status"] for e in staff.get("/v1/audit?action=DELETE").json()["entries"]] == [202, 202]
        sets = [delivery.message for delivery in told.receive(1.0)]
        assert isinstance(sets[-1], ZoneSet)
        assert sets[-1].zones[-1].rules[0].devices[0].startswith(ERASED)
    wait_until(lambda: phone.device in listener.erased(), 10, "everybody to be told whom to forget")


def held_back(gateway: Running, method_and_path: str, body: bytes, *headers: str) -> socket.socket:
    """Begin a request and return once the gateway asks for its body: it has looked at the head by then."""
    line = socket.create_connection(("127.0.0.1", gateway.http.base_url.port or 0), timeout=10)
    head = [f"{method_and_path} HTTP/1.1", "Host: x", f"Content-Length: {len(body)}", "Expect: 100-continue", *headers]
    line.sendall("\r\n".join([*head, "", ""]).encode())
    assert b" 100 " in line.recv(4096)
    return line


def test_a_batch_whose_body_ends_after_the_consent_was_withdrawn_is_refused(
    gateway: Running, listener: Listener
) -> None:
    phone, other = Phone(gateway), Phone(gateway)
    body = json.dumps(phone.batch(0)).encode()
    authorization = f"Authorization: {phone.headers['Authorization']}"
    with held_back(gateway, f"POST {phone.enrolled['batches']}", body, authorization) as line:
        line.sendall(body[:100])
        assert phone.http.delete(f"/v1/devices/{phone.device}", headers=phone.headers).status_code == 204
        line.sendall(body[100:])
        assert b" 401 " in line.recv(4096).split(b"\r\n")[0]
    other.post(other.batch(0))
    wait_until(lambda: listener.heard(other.device)[0], 10, "a scan posted later")
    assert listener.heard(phone.device) == ([], [])


def test_the_page_shows_the_batch_with_worked_examples_that_work(gateway: Running) -> None:
    document = gateway.http.get("/openapi.json").json()
    body = document["paths"]["/v1/devices/{device}/batches"]["post"]["requestBody"]["content"]["application/json"]
    name = body["schema"]["$ref"].rpartition("/")[2]
    assert {"sent", "seq"} == set(document["components"]["schemas"][name]["required"])
    assert "InertialColumns" in document["components"]["schemas"]
    phone = Phone(gateway)
    for example in body["examples"].values():
        assert phone.post(example["value"]).status_code in (200, 202)  # their times are long past
    assert {path for path in document["paths"] if not path.startswith("/v1/adapters/")} == {
        "/v1/consent",
        "/v1/devices",
        "/v1/enrolment.svg",
        "/v1/devices/{device}",
        "/v1/devices/{device}/alerts",
        "/v1/devices/{device}/batches",
        "/v1/devices/{device}/export",
        "/v1/devices/{device}/position",
        "/v1/devices/{device}/tokens",
        "/v1/devices/{device}/tokens/{token}",
        "/v1/devices/{device}/trial-walks",
        "/v1/schema/{name}.json",
    }


def test_unknown_paths_and_methods_answer_in_the_same_form(gateway: Running) -> None:
    assert problem(gateway.http.get("/v2/devices"))["found"] == "GET /v2/devices"
    assert gateway.http.put("/v1/devices").status_code == 405


def test_metrics_count_what_was_refused_and_ignored(gateway: Running) -> None:
    phone = Phone(gateway)
    phone.post(phone.batch(0))
    phone.post({"sent": 1.0, "seq": 0})
    text = httpx.get(f"{gateway.health}/metrics").text
    for series in (
        'atrium_gateway_batches_total{result="accepted"}',
        'atrium_gateway_ignored_total{reason="unknown address"}',
        'atrium_gateway_refused_total{status="422"}',
    ):
        assert series in text


@pytest.fixture
def alone(tmp_path: Path) -> Iterator[Callable[..., Running]]:
    """Start gateways that belong to one test."""
    started: list[Running] = []

    def start(endpoint: str, **settings: str) -> Running:
        started.append(launch(endpoint, tmp_path, **settings))
        return started[-1]

    yield start
    for running in started:
        finish(running)


def test_what_is_acknowledged_while_the_router_is_away_arrives_when_it_is_back(
    alone: Callable[..., Running], free_port: int
) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    session = router(endpoint)
    running = alone(endpoint)
    wait_until(lambda: is_ready(running), 30, "the gateway to be ready")
    phone = Phone(running)
    assert phone.post(phone.batch(0)).status_code == 200
    session.close()
    wait_until(lambda: not is_ready(running), 15, "the gateway to miss its router")
    assert phone.post(phone.batch(1)).status_code == 200  # spooled
    gone = Phone(running)  # enrolment needs no bus
    assert gone.post(gone.batch(0)).status_code == 200
    assert running.http.delete(f"/v1/devices/{gone.device}", headers=gone.headers).status_code == 204
    session = router(endpoint)
    listener = Listener(endpoint)
    wait_until(lambda: is_ready(running), 15, "the gateway to find its router again")
    wait_until(lambda: listener.heard(phone.device)[0], 10, "the scan that had waited")
    assert [scan.seq for scan in listener.heard(phone.device)[0]] == [1]
    assert listener.heard(gone.device) == ([], [])
    listener.bus.close()
    session.close()


def test_a_restart_keeps_the_enrolled(alone: Callable[..., Running], zenoh_router: str) -> None:
    first = alone(zenoh_router)
    wait_until(lambda: is_ready(first), 30, "the gateway to be ready")
    phone = Phone(first)
    assert finish(first) == 0
    second = alone(zenoh_router)
    wait_until(lambda: is_ready(second), 30, "the gateway to be ready again")
    phone.http = second.http
    assert phone.post(phone.batch(0)).status_code == 200


def test_a_consent_withdrawn_elsewhere_ends_the_token_here_too(
    alone: Callable[..., Running], zenoh_router: str
) -> None:
    running = alone(zenoh_router, ATRIUM_TOKEN_RECHECK="0.2")
    wait_until(lambda: is_ready(running), 30, "the gateway to be ready")
    phone = Phone(running)
    assert phone.post(phone.batch(0)).status_code == 200
    with closing(sqlite3.connect(running.database)) as database, database:
        database.execute("UPDATE gateway_devices SET revoked = 1.0, token_sha256 = NULL")
    wait_until(lambda: phone.post(phone.batch(1)).status_code == 401, 10, "the token to be refused")


def test_guessing_the_key_is_stopped(alone: Callable[..., Running], zenoh_router: str) -> None:
    running = alone(zenoh_router, ATRIUM_ENROLMENT_BURST="30", ATRIUM_ENROLMENTS_PER_MINUTE="1")
    wait_until(lambda: is_ready(running), 30, "the gateway to be ready")
    guess = {"enrolment_key": "wrong-key", "consent": True}
    answers = [running.http.post("/v1/devices", json=guess) for _ in range(5)]
    assert [answer.status_code for answer in answers] == [403, 403, 403, 429, 429]
    assert int(answers[-1].headers["retry-after"]) > 1
    assert running.http.get("/v1/enrolment.svg", auth=("x", KEY)).status_code == 401


def test_bodies_held_back_and_sent_together_make_no_burst_of_guesses(
    alone: Callable[..., Running], zenoh_router: str
) -> None:
    running = alone(zenoh_router, ATRIUM_ENROLMENT_BURST="30", ATRIUM_ENROLMENTS_PER_MINUTE="1")
    wait_until(lambda: is_ready(running), 30, "the gateway to be ready")
    guess = json.dumps({"enrolment_key": "wrong-key", "consent": True}).encode()
    with ExitStack() as stack:
        lines = [stack.enter_context(held_back(running, "POST /v1/devices", guess)) for _ in range(8)]
        for line in lines:
            line.sendall(guess)
        answers = sorted(line.recv(4096).split()[1] for line in lines)
    assert answers == [b"403"] * 3 + [b"429"] * 5


def test_outside_the_demo_a_missing_schema_or_a_default_key_stops_the_start(tmp_path: Path, zenoh_router: str) -> None:
    own = {"ATRIUM_TOKEN_KEY": "a key for the tokens of these tests", "ATRIUM_ADDRESS_KEY": "a key for addresses"}
    missing = launch(zenoh_router, tmp_path, ATRIUM_PROFILE="production", **own)
    assert missing.process.wait(20) == 1
    default = launch(zenoh_router, tmp_path, ATRIUM_PROFILE="production", ATRIUM_ENROLMENT_KEY="demo-enrolment-key")
    assert default.process.wait(20) == 2
