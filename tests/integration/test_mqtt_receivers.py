"""The MQTT client against a real broker: certificates, passwords, a broker that is late, retained messages."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import paho.mqtt.client as mqtt
import pytest
from certificates import make_certificate
from mosquitto_broker import Mosquitto
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.reasoncodes import ReasonCode
from prometheus_client import REGISTRY
from structlog.testing import capture_logs
from waiting import wait_until

from services.gateway.adapters import mqtt_receivers
from services.gateway.adapters.mqtt_broker import Broker
from services.gateway.adapters.mqtt_receivers import MqttReceivers
from services.gateway.phones.heard import Heard

TOPIC = "espresense/devices/x/entrance"

Listen = Callable[..., tuple[list[str | None], list[Heard]]]


@pytest.fixture
def listen() -> Iterator[Listen]:
    running: list[MqttReceivers] = []

    def start(url: str, authorities: Path | None = None) -> tuple[list[str | None], list[Heard]]:
        told: list[str | None] = []
        heard: list[Heard] = []
        broker = Broker.of(url, authorities)
        receivers = MqttReceivers(broker, [TOPIC, "home/#"], lambda found, _: heard.extend(found), told.append)
        running.append(receivers)
        receivers.start()
        return told, heard

    yield start
    for receivers in running:
        receivers.stop()


def connected() -> bool:
    return REGISTRY.get_sample_value("atrium_gateway_mqtt_connected") == 1.0


def attempts(result: str) -> float:
    return REGISTRY.get_sample_value("atrium_gateway_mqtt_connections_total", {"result": result}) or 0.0


def publish(broker: Mosquitto, certificate: Path | None = None, retain: bool = False) -> None:
    client = mqtt.Client(CallbackAPIVersion.VERSION2)
    client.username_pw_set(Mosquitto.USER, Mosquitto.PASSWORD)
    if certificate is not None:
        client.tls_set(str(certificate))
    client.connect("127.0.0.1", broker.port)
    client.loop_start()
    client.publish(TOPIC, json.dumps({"id": "x", "rssi": -60}), qos=1, retain=retain).wait_for_publish(10)
    client.disconnect()
    client.loop_stop()


def heard_again(broker: Mosquitto, heard: list[Any], certificate: Path | None = None) -> Callable[[], Any]:
    def again() -> Any:
        publish(broker, certificate)
        return heard

    return again


def test_a_broker_is_believed_by_its_certificate(tmp_path: Path, listen: Listen) -> None:
    certificate = make_certificate(tmp_path)
    broker = Mosquitto(tmp_path, certificate)
    broker.start()
    try:
        before = attempts("failed")
        _, strangers = listen(broker.url)  # nobody whom the system trusts has signed it
        wait_until(lambda: attempts("failed") > before, 15, "the broker not to be believed")
        _, heard = listen(broker.url, certificate)
        wait_until(heard_again(broker, heard, certificate), 15, "a reading over TLS")
        assert strangers == []
    finally:
        broker.stop()


def test_a_broker_that_starts_later_is_found(tmp_path: Path, listen: Listen) -> None:
    broker = Mosquitto(tmp_path)
    _, heard = listen(broker.url)
    broker.start()
    try:
        wait_until(heard_again(broker, heard), 20, "a reading")
    finally:
        broker.stop()


def test_a_wrong_password_is_told_and_never_itself(tmp_path: Path, listen: Listen) -> None:
    broker = Mosquitto(tmp_path)
    broker.start()
    try:
        with capture_logs() as logs:
            told, _ = listen(broker.url.replace(Mosquitto.PASSWORD, "not-the-password"))
            before = attempts("refused")
            wait_until(lambda: attempts("refused") > before, 15, "another attempt")
        assert "refuses the gateway" in str(told[0])
        assert "not-the-password" not in f"{told} {logs}"
        assert not connected()
    finally:
        broker.stop()


def test_a_topic_that_the_broker_keeps_to_itself_is_told() -> None:
    told: list[str | None] = []
    receivers = MqttReceivers(Broker.of("mqtt://broker"), [TOPIC, "home/#"], lambda *_: None, told.append)
    granted, refused = (ReasonCode(PacketTypes.SUBACK, identifier=code) for code in (0x00, 0x87))  # not authorised
    receivers._on_subscribe(None, None, 1, [granted, refused], None)
    receivers._on_subscribe(None, None, 2, [granted, granted], None)
    assert told == ["the MQTT broker broker does not let the gateway read home/#", None]


def test_a_client_that_dies_is_told_of_and_begins_anew(
    tmp_path: Path, listen: Listen, monkeypatch: pytest.MonkeyPatch
) -> None:
    broker = Mosquitto(tmp_path)
    monkeypatch.setattr(mqtt_receivers, "RETRY", (1, 0.1))
    deaths = [RuntimeError("once")]

    class Mortal(mqtt.Client):
        def reconnect(self) -> mqtt.MQTTErrorCode:
            if deaths:
                raise deaths.pop()
            return super().reconnect()

    monkeypatch.setattr(mqtt_receivers.mqtt, "Client", Mortal)
    broker.start()
    try:
        told, _ = listen(broker.url)
        wait_until(lambda: None in told, 15, "the client to be well again")
        assert "RuntimeError" in str(told[0])
    finally:
        broker.stop()


def test_what_was_retained_is_not_heard_now(tmp_path: Path, listen: Listen) -> None:
    broker = Mosquitto(tmp_path)
    broker.start()
    try:
        publish(broker, retain=True)
        _, heard = listen(broker.url)
        wait_until(connected, 15, "the broker")
        wait_until(heard_again(broker, heard), 15, "what is published now")
        assert {reading.rssi for reading in heard} == {-60.0}
        assert REGISTRY.get_sample_value("atrium_gateway_mqtt_messages_total", {"result": "retained"}) in (None, 0.0)
    finally:
        broker.stop()
