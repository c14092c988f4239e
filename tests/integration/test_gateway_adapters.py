"""Other people's apps and receivers against the real gateway: real HTTP, a real MQTT broker, a real bus."""

import gzip
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import paho.mqtt.client as mqtt
import pytest
import yaml
from conftest import ROOT, unused_port
from mosquitto_broker import Mosquitto
from paho.mqtt.enums import CallbackAPIVersion
from service_process import process
from waiting import wait_until

from shared.bus import Bus, router
from shared.keys import Keys
from shared.messages import Message, MotionBatch, RadioScan

FIXTURES = ROOT / "tests/fixtures"
KEY = "a-key-for-tests"
STAFF = "a-key-for-staff-of-tests"
RECEIVER_KEY = "a-key-for-receivers-of-tests"
TAG, BEACON = "02:EE:00:00:00:01", "iBeacon:426c7565-0000-4000-8000-000000000001-3838-4949"
RECEIVERS = ["pi-entrance", "entrance", "TheengsGateway", "OMG_Hall"]


def session() -> list[bytes]:
    with gzip.open(FIXTURES / "sensor_logger_session.jsonl.gz") as lines:
        return lines.read().splitlines()


def site(folder: Path) -> Path:
    """The demo's hall, with receivers at one access point and the mall's loudest Wi-Fi at another."""
    document = yaml.safe_load((ROOT / "deploy/sites/hall/site.yaml").read_text())
    document["access_points"][0]["receivers"] = RECEIVERS
    heard = [entry["values"] for push in session() for entry in json.loads(push)["payload"] if entry["name"] == "wifi"]
    document["access_points"][1]["addresses"] += sorted({one["bssid"] for one in heard if one["level"] > -70})
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


@dataclass
class World:
    http: httpx.Client
    health: str
    broker: Mosquitto
    log: Path
    endpoint: str
    messages: list[Message] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.bus = Bus([self.endpoint])
        self.inbox = self.bus.inbox()
        self.inbox.subscribe(Keys("hall").radio(), RadioScan)
        self.inbox.subscribe(Keys("hall").motion(), MotionBatch)

    def enrol(self, *transmitters: str) -> tuple[str, str]:
        body = {"enrolment_key": KEY, "consent": True, "carrying": "hand", "transmitters": list(transmitters)}
        if transmitters:
            body["staff_key"] = STAFF
        answer = self.http.post("/v1/devices", json=body)
        assert answer.status_code == 201, answer.text
        return answer.json()["device"], answer.json()["token"]

    def withdraw(self, device: str, token: str) -> None:
        answer = self.http.delete(f"/v1/devices/{device}", headers={"Authorization": f"Bearer {token}"})
        assert answer.status_code == 204

    def heard(self, device: str) -> list[Any]:
        self.messages += [delivery.message for delivery in self.inbox.receive(0.05)]
        return [m for m in self.messages if getattr(m, "device", None) == device]

    def metrics(self) -> str:
        return httpx.get(f"{self.health}/metrics").text

    def count(self, name: str) -> float:
        lines = [line for line in self.metrics().splitlines() if line.startswith(name + " ")]
        return float(lines[0].rpartition(" ")[2]) if lines else 0.0


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    folder = tmp_path_factory.mktemp("adapters")
    endpoint, port = f"tcp/127.0.0.1:{unused_port()}", unused_port()
    session_of_router = router(endpoint)
    broker = Mosquitto(folder)
    broker.start()
    environment = {
        "ATRIUM_GATEWAY_PORT": str(port),
        "ATRIUM_ENROLMENT_KEY": KEY,
        "ATRIUM_STAFF_KEY": STAFF,
        "ATRIUM_RECEIVER_KEY": RECEIVER_KEY,
        "ATRIUM_MQTT_URL": broker.url,
        "ATRIUM_LOG_LEVEL": "debug",
    }
    try:
        with (
            process("services.gateway", folder, endpoint, site(folder), **environment) as health,
            httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=10.0) as http,
        ):
            found = World(http, health, broker, folder / "services.gateway.log", endpoint)
            yield found
            found.bus.close()
    finally:
        broker.stop()
        session_of_router.close()


@pytest.fixture
def publish(world: World) -> Iterator[Callable[[str, Any], None]]:
    """Publish as a receiver does, once the gateway listens."""
    wait_until(lambda: world.count("atrium_gateway_mqtt_connected") == 1.0, 20, "the gateway to reach the broker")
    client = mqtt.Client(CallbackAPIVersion.VERSION2)
    client.username_pw_set(Mosquitto.USER, Mosquitto.PASSWORD)
    client.connect("127.0.0.1", world.broker.port)
    client.loop_start()

    def send(topic: str, payload: Any) -> None:
        body = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
        client.publish(topic, body, qos=1).wait_for_publish(10)

    yield send
    client.disconnect()
    client.loop_stop()


def fixture(name: str) -> Any:
    return json.loads((FIXTURES / name).read_text())


def test_a_real_walk_in_sensor_loggers_pushes_becomes_steps_and_scans(world: World) -> None:
    device, token = world.enrol()
    for number, push in enumerate(session()):
        answer = world.http.post(
            "/v1/adapters/sensor-logger", content=push, headers={"Authorization": f"Bearer {token}"}
        )
        assert answer.status_code == 200, answer.text
        assert not answer.json()["duplicate"], number
    again = world.http.post(f"/v1/adapters/sensor-logger/{token}", content=push)
    assert again.status_code == 200
    assert again.json()["duplicate"]

    def steps() -> int:
        return sum(len(m.step_t) for m in world.heard(device) if isinstance(m, MotionBatch))

    wait_until(lambda: steps() >= 30, 10, "the steps of 25 s of walking")
    assert steps() <= 55
    scans = [m for m in world.heard(device) if isinstance(m, RadioScan)]
    assert scans
    assert {point for scan in scans for point in scan.access_point} == {"ap-2"}
    assert not any(scan.heard_by_site for scan in scans)
    assert "mall" not in world.metrics()


def test_a_second_recording_counts_from_zero_again_and_is_taken(world: World) -> None:
    _, token = world.enrol()
    first = json.loads(session()[0])
    for name in ("one", "two"):
        answer = world.http.post(f"/v1/adapters/sensor-logger/{token}", json=first | {"sessionId": name})
        assert answer.json()["duplicate"] is False, answer.text


def test_a_bare_token_in_the_header_is_enough(world: World) -> None:
    _, token = world.enrol()
    empty = {"messageId": 0, "sessionId": "s", "deviceId": "d", "payload": []}
    answer = world.http.post("/v1/adapters/sensor-logger", json=empty, headers={"Authorization": token})
    assert answer.status_code == 200
    assert answer.json()["accepted"] == {"samples": 0, "scans": 0, "readings": 0}


def test_a_phone_with_find3_is_answered_as_find3_does_and_scanned(world: World) -> None:
    device, token = world.enrol()
    body = fixture("find3_data.json") | {"t": int(time.time() * 1000)}
    answer = world.http.post(f"/v1/adapters/find3/{token}/data", json=body)
    assert answer.status_code == 200, answer.text
    assert answer.json() == {"success": True, "message": "inserted data"}
    (scan,) = wait_until(lambda: world.heard(device), 10, "the scan")
    assert dict(zip(scan.access_point, scan.rssi, strict=True)) == {"ap-1": -47, "ap-2": -58, "ap-3": -73}
    assert (scan.kind, scan.heard_by_site) == ("wifi", False)
    assert abs(scan.t - time.time()) < 5.0


def test_a_receiver_with_find3_hears_the_enrolled_tag_alone(world: World) -> None:
    device, token = world.enrol(TAG)
    body = fixture("find3_passive.json") | {"t": int(time.time() * 1000)}

    def heard() -> Any:
        answer = world.http.post(f"/v1/adapters/find3/{RECEIVER_KEY}/passive", json=body)
        assert answer.status_code == 200, answer.text
        assert answer.json()["success"]
        return answer.json()["message"] == "inserted 1 fingerprints"

    wait_until(heard, 10, "the tag to be known")
    (scan, *_) = wait_until(lambda: world.heard(device), 10, "the scan")
    assert scan.heard_by_site
    assert (scan.access_point, scan.rssi, scan.kind) == (["ap-1"], [-61], "wifi")
    world.withdraw(device, token)
    answer = world.http.post(f"/v1/adapters/find3/{RECEIVER_KEY}/passive", json=body)
    assert answer.json()["message"] == "inserted 0 fingerprints"


def test_receivers_over_mqtt_hear_the_enrolled_tag_alone(world: World, publish: Callable[[str, Any], None]) -> None:
    device, token = world.enrol(TAG, BEACON)
    messages = fixture("espresense.json") + fixture("theengs.json")

    def heard() -> Any:
        for message in messages:
            publish(message["topic"], message["payload"])
        scans = world.heard(device)
        return any(len(scan.rssi) == 1 and scan.heard_by_site for scan in scans) and scans

    scans = wait_until(heard, 20, "the scan of the tag")
    assert {tuple(scan.access_point) for scan in scans} == {("ap-1",)}
    assert all(-82.0 <= scan.rssi[0] <= -71.1 for scan in scans)
    world.withdraw(device, token)
    for name in (TAG, BEACON, messages[1]["payload"]["mac"], "5E8757", "apple:1005"):
        for shape in (name, name.replace(":", ""), name.replace("-", "")):
            assert shape.lower() not in world.log.read_text().lower()
            assert shape.lower() not in world.metrics().lower()


def test_a_stranger_leaves_nothing_but_a_number(world: World, publish: Callable[[str, Any], None]) -> None:
    world.heard("")
    already = len(world.messages)
    name = 'atrium_gateway_receiver_readings_total{result="not enrolled"}'
    before = world.count(name)
    stranger = fixture("espresense.json")[1]
    publish(stranger["topic"], stranger["payload"])
    wait_until(lambda: world.count(name) == before + 1, 10, "the stranger to be counted")
    device, token = world.enrol()  # whatever would come of the stranger would be here before this phone's scan
    world.http.post(f"/v1/adapters/find3/{token}/data", json=fixture("find3_data.json"))
    wait_until(lambda: world.heard(device), 10, "the phone's scan")
    assert {getattr(m, "device", "") for m in world.messages[already:]} == {device}
    for shape in (stranger["payload"]["mac"], stranger["payload"]["id"], stranger["topic"]):
        assert shape not in world.log.read_text()
        assert shape not in world.metrics()


def test_a_broker_that_comes_back_is_listened_to_again(world: World) -> None:
    device, token = world.enrol(TAG)
    world.broker.stop()
    wait_until(lambda: world.count("atrium_gateway_mqtt_connected") == 0.0, 20, "the gateway to miss the broker")
    world.broker.start()
    wait_until(lambda: world.count("atrium_gateway_mqtt_connected") == 1.0, 30, "the gateway to come back")
    client = mqtt.Client(CallbackAPIVersion.VERSION2)
    client.username_pw_set(Mosquitto.USER, Mosquitto.PASSWORD)
    client.connect("127.0.0.1", world.broker.port)
    client.loop_start()
    message = fixture("theengs.json")[0]

    def heard() -> Any:
        client.publish(message["topic"], json.dumps(message["payload"])).wait_for_publish(10)
        return world.heard(device)

    try:
        wait_until(heard, 20, "the tag to be heard again")
    finally:
        client.disconnect()
        client.loop_stop()
    world.withdraw(device, token)


@pytest.mark.parametrize(
    "payload", [b"\xff\xfe", b"{}", b'{"rssi": NaN}', b"[" * 5000, b"\x00" * 100_000, b'{"rssi": 1e999}']
)
def test_nonsense_over_mqtt_does_no_harm(world: World, publish: Callable[[str, Any], None], payload: bytes) -> None:
    publish("espresense/devices/x/entrance", payload)
    publish("home/OMG_Hall/BTtoMQTT/x", payload)
    name = 'atrium_gateway_mqtt_messages_total{result="understood"}'
    before = world.count(name)
    good = fixture("espresense.json")[1]
    publish(good["topic"], good["payload"])
    wait_until(lambda: world.count(name) == before + 1, 10, "the next message to be understood")
    assert world.count('atrium_gateway_mqtt_messages_total{result="failed"}') == 0.0


def refused(answer: httpx.Response) -> dict[str, Any]:
    found: dict[str, Any] = answer.json()
    assert found["detail"], answer.text
    return found


def test_nobody_posts_without_a_token_that_may_post(world: World) -> None:
    device, token = world.enrol()
    asked = world.http.post(
        f"/v1/devices/{device}/tokens", json={"scopes": ["read"]}, headers={"Authorization": f"Bearer {token}"}
    )
    reading = asked.json()["token"]
    push = session()[0]
    for given, status in (("", 401), ("Bearer", 401), ("Bearer nonsense", 401), (f"Bearer {reading}", 403)):
        answer = world.http.post("/v1/adapters/sensor-logger", content=push, headers={"Authorization": given})
        assert answer.status_code == status
        refused(answer)
    assert world.http.post("/v1/adapters/sensor-logger/nonsense", content=push).status_code == 401
    answer = world.http.post("/v1/adapters/find3/nonsense/data", json=fixture("find3_data.json"))
    assert answer.status_code == 401
    assert refused(answer)["success"] is False
    assert world.http.post("/v1/adapters/find3/nonsense/passive", content=b"{}").status_code == 403
    assert world.http.post(f"/v1/adapters/find3/{token}/passive", content=b"{}").status_code == 403
    world.withdraw(device, token)
    assert world.http.post(f"/v1/adapters/sensor-logger/{token}", content=push).status_code == 401


def test_bad_posts_are_refused_in_the_senders_words_and_nothing_is_published(world: World) -> None:
    device, token = world.enrol()
    path = f"/v1/adapters/sensor-logger/{token}"
    many = {str(number): -40 for number in range(10_000)}
    cases: list[tuple[str, bytes, int, str]] = [
        (path, b"\xff\xfe", 400, "body"),
        (
            path,
            b'{"messageId":0,"payload":[{"name":"gyroscope","time":1,"values":{"x":1e9,"y":0,"z":0}}]}',
            422,
            "payload[0].values.x",
        ),
        (path, b"x" * 3_000_000, 413, "body"),
        (path + "?frame=up", session()[0], 422, "frame"),
        (f"/v1/adapters/find3/{token}/data", b'{"d":"a","t":17,"s":{}}', 422, "t"),
        (
            f"/v1/adapters/find3/{RECEIVER_KEY}/passive",
            json.dumps({"d": "pi-entrance", "t": time.time() * 1000, "s": {"wifi": many}}).encode(),
            422,
            "s.wifi",
        ),
        (
            f"/v1/adapters/find3/{RECEIVER_KEY}/passive",
            json.dumps({"d": "nowhere", "t": time.time() * 1000, "s": {}}).encode(),
            422,
            "d",
        ),
    ]
    for where, body, status, name in cases:
        answer = world.http.post(where, content=body)
        assert answer.status_code == status, answer.text
        assert refused(answer)["detail"][0]["field"] == name
    assert world.heard(device) == []


def test_no_token_and_no_key_stands_in_the_log(world: World) -> None:
    device, token = world.enrol()
    world.http.post(f"/v1/adapters/sensor-logger/{token}", content=b"{")
    world.http.get(f"/v1/adapters/find3/{token}/data")
    world.http.post(f"/v1/adapters/find3/{RECEIVER_KEY}/passive", content=b"{")
    world.withdraw(device, token)
    text = world.log.read_text() + world.metrics()
    for secret in (token, RECEIVER_KEY, Mosquitto.PASSWORD, KEY):
        assert secret not in text
