"""What apps may rely on beyond the plain batch: compression, flushes, rations, consent texts, tokens, own data."""

import gzip
import json
import socket
import time
import zlib
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import pytest
from gateway_process import KEY, STAFF, Listener, Phone, Running, problem, running_gateway
from jsonschema_rs import Draft202012Validator
from waiting import wait_until

from services.gateway.devices.tokens import TokenSigner, keys_of
from services.gateway.settings import GatewaySettings
from shared.messages import Alert

CONSENT = "version: 2026-05\nMay we?\n"


@pytest.fixture(scope="module")
def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    folder = tmp_path_factory.mktemp("gateway")
    (folder / "consent.txt").write_text(CONSENT, encoding="utf-8")
    settings = {
        "ATRIUM_CONSENT_FILE": str(folder / "consent.txt"),
        "ATRIUM_LIVE_LATENESS": "5",
        "ATRIUM_BATCHES_PER_SECOND": "0.5",
        "ATRIUM_BATCH_BURST": "40",
        "ATRIUM_BODY_SECONDS": "3",
        "ATRIUM_OPEN_BODIES": "4",
    }
    with running_gateway(folder, **settings) as running:
        yield running


@pytest.fixture(scope="module")
def listener(gateway: Running) -> Iterator[Listener]:
    listening = Listener(gateway.endpoint)
    yield listening
    listening.bus.close()


# ---- batches


@pytest.mark.parametrize(
    ("name", "compress"), [("gzip", gzip.compress), ("GZIP", gzip.compress), ("deflate", zlib.compress)]
)
def test_a_compressed_batch_is_taken(gateway: Running, name: str, compress: Any) -> None:
    phone = Phone(gateway)
    answer = phone.post(compress(json.dumps(phone.batch(0)).encode()), **{"Content-Encoding": name})
    assert answer.is_success, answer.text
    assert answer.json()["accepted"]["samples"] == 50


def bomb(size: int) -> bytes:
    """Gzip that unpacks to ``size`` zeros, without packing them all: every part of it is the same."""
    packer = zlib.compressobj(9, zlib.DEFLATED, 31)
    part = bytes(1 << 24)
    head = packer.compress(part) + packer.flush(zlib.Z_FULL_FLUSH)
    same = packer.compress(part) + packer.flush(zlib.Z_FULL_FLUSH)
    return head + same * (size // len(part) - 1)


def test_a_megabyte_that_unpacks_to_a_gigabyte_is_refused_without_being_unpacked(gateway: Running) -> None:
    phone = Phone(gateway)
    body = bomb(1 << 30)
    assert 900_000 < len(body) < 1 << 20
    begin = time.monotonic()
    answer = phone.post(body, **{"Content-Encoding": "gzip"})
    assert (answer.status_code, problem(answer)["field"]) == (413, "body")
    assert "unpack to more" in problem(answer)["found"]
    assert time.monotonic() - begin < 2.0
    status = Path(f"/proc/{gateway.process.pid}/status").read_text(encoding="utf-8")
    peak = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))
    assert peak < 700_000  # kB


def test_broken_compression_is_named(gateway: Running) -> None:
    phone = Phone(gateway)
    good = gzip.compress(json.dumps(phone.batch(0)).encode())
    for body, found in ((b"no gzip", "header"), (good[:-9], "too early"), (good + b"more", "4 bytes after its end")):
        answer = phone.post(body, **{"Content-Encoding": "gzip"})
        assert (answer.status_code, problem(answer)["field"]) == (400, "body")
        assert found in problem(answer)["found"]
    assert problem(phone.post(good, **{"Content-Encoding": "gzip, gzip"}))["allowed"] == "gzip, deflate or none"


def test_an_hours_flush_is_accepted_and_marked_late_and_what_is_fresh_is_not(
    gateway: Running, listener: Listener
) -> None:
    phone = Phone(gateway)
    phone.start = time.time() - 3500.0
    for part in range(18):  # 200 s at 50 Hz in each
        sent = time.time()
        t = [phone.start + 190.0 * part + i / 50 for i in range(9500)]
        columns: dict[str, Any] = {name: [0.0] * 9500 for name in ("ax", "ay", "gx", "gy", "gz")}
        radio = [{"t": t[-1], "address": ["02:a7:00:00:00:01"], "rssi": [-50]}]
        imu = {"t": t, "az": [9.81] * 9500, **columns}
        body = gzip.compress(json.dumps({"sent": sent, "seq": part, "imu": imu, "radio": radio}).encode(), 1)
        answer = phone.post(body, **{"Content-Encoding": "gzip"})
        assert (answer.status_code, answer.json()["late"]) == (202, True), answer.text
    now = time.time()
    live = {"sent": now, "seq": 18, "radio": [{"t": now - 0.5, "address": ["02:a7:00:00:00:01"], "rssi": [-50]}]}
    answer = phone.post(live)
    assert (answer.status_code, answer.json()["late"]) == (200, False)
    wait_until(lambda: len(listener.heard(phone.device)[0]) == 19, 10, "all scans")
    scans, motions = listener.heard(phone.device)
    assert [scan.late for scan in scans] == [True] * 18 + [False]
    assert motions
    assert all(motion.late for motion in motions)


def test_a_device_that_posts_too_fast_is_told_when_to_go_on_and_others_are_not(gateway: Running) -> None:
    phone, other = Phone(gateway), Phone(gateway)
    now = time.time()
    body = {"sent": now, "seq": 0, "radio": [{"t": now, "address": [], "rssi": []}]}
    answers = [phone.post(body | {"seq": seq}) for seq in range(45)]
    refused = [answer for answer in answers if answer.status_code == 429]
    assert 3 <= len(refused) <= 5
    assert 1 <= int(refused[0].headers["retry-after"]) <= 2
    assert refused[0].json()["retry_after"] == int(refused[0].headers["retry-after"])
    assert other.post(body).status_code == 200


def test_a_reply_tells_offset_and_drift_of_the_phones_clock(gateway: Running) -> None:
    phone = Phone(gateway, clock=12.0)
    reply = phone.post(phone.batch(0)).json()
    assert reply["clock_offset"] == pytest.approx(-12.0, abs=0.5)
    assert abs(reply["clock_drift"]) < 1e-3


# ---- enrolment


def enrol(gateway: Running, **more: Any) -> httpx.Response:
    return gateway.http.post("/v1/devices", json={"enrolment_key": KEY, "consent": True, **more})


def test_the_consent_text_is_the_sites_and_only_its_version_is_agreed_to(gateway: Running) -> None:
    assert gateway.http.get("/v1/consent").json() == {"version": "2026-05", "text": "May we?"}
    answer = enrol(gateway, consent_version="2025-01")
    assert answer.status_code == 422
    assert problem(answer) == {
        "field": "consent_version",
        "problem": "is not the text that is valid now",
        "found": "2025-01",
        "allowed": "2026-05",
    }
    assert enrol(gateway, consent_version="2026-05").json()["consent_version"] == "2026-05"
    assert enrol(gateway).json()["consent_version"] == "2026-05"


def test_transmitters_are_one_devices_and_come_free_when_it_goes(gateway: Running) -> None:
    tag = "02:B7:00:00:00:99"
    first = enrol(gateway, transmitters=[tag], staff_key=STAFF)
    assert first.status_code == 201
    answer = enrol(gateway, transmitters=["02:b7:00:00:00:98", tag.lower()], staff_key=STAFF)
    assert (answer.status_code, problem(answer)["field"]) == (422, "transmitters[1]")
    for wrong in (["x"] * 9, [""], ["x" * 65], ["apple:1005:9-24"], [1]):
        answer = enrol(gateway, transmitters=wrong, staff_key=STAFF)
        assert answer.status_code == 422
        assert problem(answer)["field"].startswith("transmitters")
    headers = {"Authorization": f"Bearer {first.json()['token']}"}
    assert gateway.http.delete(f"/v1/devices/{first.json()['device']}", headers=headers).status_code == 204
    assert enrol(gateway, transmitters=[tag], staff_key=STAFF).status_code == 201


def test_only_staff_claim_transmitters(gateway: Running) -> None:
    for key in ({}, {"staff_key": "a wrong one"}, {"staff_key": KEY}):
        answer = enrol(gateway, transmitters=["02:b7:00:00:00:97"], **key)
        assert (answer.status_code, problem(answer)["field"]) == (403, "staff_key")


def test_a_token_may_withdraw_the_consent_after_its_end_and_nothing_else(gateway: Running) -> None:
    phone, other = Phone(gateway), Phone(gateway)
    signer = TokenSigner(keys_of(GatewaySettings.model_fields["token_key"].default.get_secret_value()))
    claims = signer.read(phone.enrolled["token"], time.time())
    assert claims is not None

    def ended(days: float, device: str = phone.device) -> dict[str, str]:
        text = signer.sign(device, claims.id, ("post", "read", "manage"), time.time() - days * 86_400)
        return {"Authorization": f"Bearer {text}"}

    path = f"/v1/devices/{phone.device}"
    assert phone.http.get(f"{path}/alerts", headers=ended(1)).status_code == 401
    assert phone.http.delete(path, headers=ended(31)).status_code == 401
    assert phone.http.delete(f"/v1/devices/{other.device}", headers=ended(1, other.device)).status_code == 401
    assert phone.http.delete(path, headers=ended(29)).status_code == 204
    assert phone.post(phone.batch(0)).status_code == 401


def test_how_a_phone_is_carried_can_change(gateway: Running) -> None:
    phone = Phone(gateway)
    path = f"/v1/devices/{phone.device}"
    answer = phone.http.patch(path, json={"carrying": "pocket"}, headers=phone.headers)
    assert (answer.status_code, answer.json()) == (200, {"device": phone.device, "carrying": "pocket"})
    answer = phone.http.patch(path, json={"carrying": "hat"}, headers=phone.headers)
    assert (answer.status_code, problem(answer)["field"]) == (422, "carrying")
    assert phone.post(phone.batch(0)).is_success


# ---- tokens


class Token:
    """A token that was handed out."""

    def __init__(self, phone: Phone, headers: dict[str, str], **asked: Any) -> None:
        answer = phone.http.post(f"/v1/devices/{phone.device}/tokens", json=asked, headers=headers)
        assert answer.status_code == 201, answer.text
        self.id: str = answer.json()["id"]
        self.expires: float = answer.json()["expires"]
        self.text: str = answer.json()["token"]
        self.headers = {"Authorization": f"Bearer {self.text}"}


def test_a_narrower_token_does_what_its_scopes_say_and_no_more(gateway: Running) -> None:
    phone = Phone(gateway)
    path = f"/v1/devices/{phone.device}"
    post, read = Token(phone, phone.headers, scopes=["post"]), Token(phone, phone.headers, scopes=["read"], seconds=60)
    assert post.expires == pytest.approx(phone.enrolled["expires"], abs=1.0)
    assert read.expires == pytest.approx(time.time() + 60, abs=5)
    batch = json.dumps(phone.batch(0))
    assert phone.http.post(f"{path}/batches", content=batch, headers=post.headers).is_success
    for method, end, token, needed in (
        ("POST", "/batches", read, "post"),
        ("PATCH", "", read, "post"),
        ("GET", "/position", post, "read"),
        ("GET", "/alerts", post, "read"),
        ("GET", "/tokens", read, "manage"),
        ("POST", "/tokens", post, "manage"),
        ("DELETE", f"/tokens/{post.id}", post, "manage"),
        ("DELETE", "", post, "manage"),
    ):
        answer = phone.http.request(method, path + end, headers=token.headers)
        assert (answer.status_code, problem(answer)["allowed"]) == (403, needed), (method, end)
    assert phone.http.get(f"{path}/alerts", headers=read.headers).status_code == 200


def test_tokens_are_listed_by_id_and_revoked_at_once(gateway: Running) -> None:
    phone, other = Phone(gateway), Phone(gateway)
    path = f"/v1/devices/{phone.device}/tokens"
    token = Token(phone, phone.headers, scopes=["post", "post"])
    listed = phone.http.get(path, headers=phone.headers).json()["tokens"]
    assert [(entry["scopes"], entry["asking"]) for entry in listed] == [
        (["post", "read", "manage"], True),
        (["post"], False),
    ]
    assert listed[1]["id"] == token.id
    assert token.text not in json.dumps(listed)
    batches = phone.enrolled["batches"]
    assert phone.http.post(batches, content=json.dumps(phone.batch(0)), headers=token.headers).is_success
    other_path = f"/v1/devices/{other.device}/tokens/{token.id}"
    assert phone.http.delete(other_path, headers=other.headers).status_code == 404
    assert phone.http.delete(f"{path}/{token.id}", headers=phone.headers).status_code == 204
    assert phone.http.delete(f"{path}/{token.id}", headers=phone.headers).status_code == 404
    assert phone.http.post(batches, content=json.dumps(phone.batch(1)), headers=token.headers).status_code == 401
    assert len(phone.http.get(path, headers=phone.headers).json()["tokens"]) == 1
    assert phone.post(phone.batch(1)).is_success


def test_a_token_request_that_asks_too_much_is_refused(gateway: Running) -> None:
    phone = Phone(gateway)
    path = f"/v1/devices/{phone.device}/tokens"
    manager = Token(phone, phone.headers, scopes=["manage"])
    answer = phone.http.post(path, json={"scopes": ["manage", "read"]}, headers=manager.headers)
    assert (answer.status_code, problem(answer)["found"]) == (403, "read")
    for wrong in ({}, {"scopes": []}, {"scopes": ["fly"]}, {"scopes": ["post"], "seconds": 59}):
        assert phone.http.post(path, json=wrong, headers=phone.headers).status_code == 422
    for _ in range(18):
        Token(phone, phone.headers, scopes=["post"])
    assert phone.http.post(path, json={"scopes": ["post"]}, headers=phone.headers).status_code == 422


def test_withdrawal_ends_every_token_of_the_device(gateway: Running) -> None:
    phone = Phone(gateway)
    token = Token(phone, phone.headers, scopes=["post"])
    assert phone.http.delete(f"/v1/devices/{phone.device}", headers=phone.headers).status_code == 204
    answer = phone.http.post(phone.enrolled["batches"], content=json.dumps(phone.batch(0)), headers=token.headers)
    assert answer.status_code == 401


# ---- own data


def test_a_phone_reads_the_alerts_of_its_own_and_of_nobody_else(gateway: Running, listener: Listener) -> None:
    phone, other = Phone(gateway), Phone(gateway)
    publisher = listener.bus.publisher(listener.keys.alert("entrance"), Alert, cached=True, history=100)
    told = {"zone": "entrance", "area": "hall", "track": 1, "floor": "ground", "x": 8.0, "y": 1.0}
    for number in range(60):
        kind = "exit" if number % 2 else "enter"
        publisher.publish(Alert(id=f"a{number}", t=100.0 + number, kind=kind, device=phone.device, **told))
    publisher.publish(Alert(id="b", t=5.0, kind="enter", device=other.device, **told))
    publisher.publish(Alert(id="c", t=6.0, kind="enter", **told))

    def alerts(of: Phone) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = of.http.get(of.enrolled["alerts"], headers=of.headers).json()["alerts"]
        return found

    wait_until(lambda: alerts(other), 10, "the alerts")
    assert [alert["t"] for alert in alerts(phone)] == [110.0 + number for number in range(50)]
    assert alerts(phone)[0] == {
        "t": 110.0, "kind": "enter", "zone": "entrance", "name": "Entrance", "floor": "ground", "x": 8.0, "y": 1.0,
    }  # fmt: skip
    assert len(alerts(other)) == 1


# ---- what the page says


def test_every_schema_is_served_and_the_examples_are_valid_by_it(gateway: Running) -> None:
    document = gateway.http.get("/openapi.json").json()
    tried = 0
    for operations in document["paths"].values():
        for operation in operations.values():
            contents = [operation["requestBody"]["content"]] if "requestBody" in operation else []
            contents += [response.get("content", {}) for response in operation["responses"].values()]
            for content in contents:
                media = content.get("application/json", {})
                for example in media.get("examples", {}).values():
                    schema = {**media["schema"], "components": document["components"]}
                    Draft202012Validator(schema).validate(example["value"])
                    tried += 1
    assert tried >= 10
    for name in ("batch", "batch-reply", "enrolment", "error-reply", "position", "trial-walks"):
        answer = gateway.http.get(f"/v1/schema/{name}.json")
        assert answer.headers["content-type"] == "application/schema+json"
        Draft202012Validator(answer.json())  # is a schema
    assert gateway.http.get("/v1/schema/nothing.json").status_code == 404
    schema = gateway.http.get("/v1/schema/batch.json").json()
    Draft202012Validator(schema).validate(Phone(gateway).batch(0))
    assert not Draft202012Validator(schema).is_valid({"sent": 1.0})


def test_a_sender_that_goes_away_in_mid_body_troubles_nobody(gateway: Running) -> None:
    phone = Phone(gateway)
    head = f"POST {phone.enrolled['batches']} HTTP/1.1\r\nHost: x\r\nContent-Length: 1000\r\n"
    with socket.create_connection(("127.0.0.1", gateway.http.base_url.port or 0), timeout=5) as line:
        line.sendall(f"{head}Authorization: {phone.headers['Authorization']}\r\n\r\n{{".encode())
    assert phone.post(phone.batch(0)).is_success


def test_slow_bodies_end_and_only_a_few_of_a_device_are_open_at_once(gateway: Running) -> None:
    phone, other = Phone(gateway), Phone(gateway)
    head = f"POST {phone.enrolled['batches']} HTTP/1.1\r\nHost: x\r\nContent-Length: 1000\r\n"
    with ExitStack() as lines:
        slow = []
        for _ in range(4):
            line = socket.create_connection(("127.0.0.1", gateway.http.base_url.port or 0), timeout=10)
            lines.enter_context(line)
            line.sendall(f"{head}Authorization: {phone.headers['Authorization']}\r\n\r\n{{".encode())
            slow.append(line)
        wait_until(lambda: phone.post(phone.batch(0)).status_code == 429, 20, "too many open bodies")
        assert other.post(other.batch(0)).is_success
        for line in slow:
            assert line.recv(4096).startswith(b"HTTP/1.1 408 ")
    assert phone.post(phone.batch(1)).is_success


def test_changes_and_tokens_are_rationed_as_batches_are(gateway: Running) -> None:
    phone = Phone(gateway)
    path = f"/v1/devices/{phone.device}"
    seen = {phone.http.patch(path, json={"carrying": "hand"}, headers=phone.headers).status_code for _ in range(45)}
    assert seen == {200, 429}
    for method, end in (("GET", "/tokens"), ("POST", "/tokens"), ("PUT", "/trial-walks")):
        answer = phone.http.request(method, path + end, headers=phone.headers)
        assert (answer.status_code, "Retry-After" in answer.headers) == (429, True), end
    assert phone.http.delete(path, headers=phone.headers).status_code == 204
