"""What ESPresense, Theengs and OpenMQTTGateway publish becomes readings under every name a tag may be enrolled by."""

import json
from typing import Any

import pytest
from conftest import ROOT
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from refusals import refusals_name_a_field

from services.gateway.adapters.espresense import Espresense
from services.gateway.adapters.mqtt_broker import Broker
from services.gateway.adapters.theengs import Theengs
from services.gateway.devices.transmitters import digest_of
from services.gateway.errors import RequestError
from services.gateway.phones.heard import Heard
from services.gateway.settings import GatewaySettings

UUID = "426c7565-0000-4000-8000-000000000001"


def messages(name: str) -> list[tuple[str, bytes]]:
    found = json.loads((ROOT / f"tests/fixtures/{name}.json").read_text())
    return [(one["topic"], json.dumps(one["payload"]).encode()) for one in found]


def heard(adapter: Any, topic: str, payload: bytes) -> list[Heard]:
    report = adapter.decode(topic, payload)
    assert report is not None
    found: list[Heard] = report.heard
    return found


def digests(reading: Heard) -> set[str]:
    return {digest_of(name, "key") for name in reading.names}


def test_an_espresense_receiver_is_named_by_its_room() -> None:
    (reading,) = heard(Espresense(), *messages("espresense")[0])
    assert (reading.receiver, reading.kind, reading.rssi, reading.t) == ("entrance", "ble", -71.1, None)
    assert digest_of("02:EE:00:00:00:02", "key") in digests(reading)
    assert digest_of(f"iBeacon:{UUID}-3838-4949", "key") in digests(reading)


def test_a_theengs_receiver_is_named_by_its_gateway() -> None:
    (reading,) = heard(Theengs(), *messages("theengs")[0])
    assert (reading.receiver, reading.kind, reading.rssi) == ("TheengsGateway", "ble", -82.0)
    assert digests(reading) == {digest_of("02:ee:00:00:00:01", "key")}


@pytest.mark.parametrize("index", [1, 2])
def test_a_beacon_is_the_same_one_whoever_hears_it_and_whatever_its_address(index: int) -> None:
    (reading,) = heard(Theengs(), *messages("theengs")[index])
    assert reading.receiver == "OMG_Hall"
    assert digest_of(f"iBeacon:{UUID}-3838-4949", "key") in digests(reading)


def test_a_sensor_without_a_level_says_nothing() -> None:
    report = Theengs().decode(*messages("theengs")[3])
    assert report is not None
    assert report.heard == []
    assert report.ignored == {"entry without its values": 1}


@pytest.mark.parametrize("topic", ["espresense/rooms/entrance/telemetry", "home/x", "", "a/b/c/d", "homeassistant/+"])
def test_topics_of_others_are_left_alone(topic: str) -> None:
    assert Espresense().decode(topic, b"{") is None
    assert Theengs().decode(topic, b"{") is None


@pytest.mark.parametrize("adapter", [Espresense(), Theengs()], ids=lambda adapter: adapter.name)
@pytest.mark.parametrize(
    ("payload", "field"),
    [
        (b"\xff", "body"),
        (b"[]", "body"),
        (b'{"rssi": "x"}', "rssi"),
        (b'{"rssi": 1e9}', "rssi"),
        (b'{"rssi": NaN}', "rssi"),
    ],
)
def test_a_mistake_is_named(adapter: Any, payload: bytes, field: str) -> None:
    topic = {"espresense": "espresense/devices/tag/room", "theengs": "home/gateway/BTtoMQTT/tag"}[adapter.name]
    with pytest.raises(RequestError) as caught:
        adapter.decode(topic, payload)
    assert caught.value.reply.detail[0].field == field


@given(st.text(max_size=30), st.binary(max_size=60))
def test_whatever_is_published_is_understood_or_refused(end: str, payload: bytes) -> None:
    for adapter, topic in ((Espresense(), f"espresense/devices/{end}/x"), (Theengs(), f"home/x/BTtoMQTT/{end}")):
        with refusals_name_a_field():
            adapter.decode(topic, payload)


@pytest.mark.parametrize(
    "other", ['"major": 1.0, "minor": 2.0', '"mac": null', '"uuid": [], "major": {}', '"major": 1.5']
)
@pytest.mark.parametrize("adapter", [Espresense(), Theengs()], ids=lambda adapter: adapter.name)
def test_a_field_beside_the_id_may_hold_anything(adapter: Any, other: str) -> None:
    topic = {"espresense": "espresense/devices/tag/room", "theengs": "home/gateway/BTtoMQTT/tag"}[adapter.name]
    (reading,) = adapter.decode(topic, f'{{"id": "a", "rssi": -60, {other}}}'.encode()).heard
    assert reading.names == ("a", "tag")


def test_a_beacon_is_known_by_whole_numbers_however_they_are_written() -> None:
    for major in ("7", "7.0"):
        payload = f'{{"id": "a", "rssi": -60, "uuid": "u", "major": {major}, "minor": 2}}'.encode()
        (reading,) = heard(Theengs(), "home/gateway/BTtoMQTT/tag", payload)
        assert "iBeacon:u-7-2" in reading.names


@pytest.mark.parametrize("topic", ["", "home/#/x", "home/a+/x", "home/a#", "home/\0", "a" * 65_536])
def test_a_topic_that_no_broker_can_be_asked_for_is_refused_at_start(topic: str) -> None:
    with pytest.raises(ValidationError, match=r"mqtt_topics[\s\S]*allowed"):
        GatewaySettings(mqtt_topics=["home/+/BTtoMQTT/#", topic])


def test_readings_show_no_address_where_they_are_printed() -> None:
    (reading,) = heard(Theengs(), *messages("theengs")[0])
    assert "02" not in repr(reading)


def test_a_brokers_url_says_how_to_get_in() -> None:
    broker = Broker.of("mqtts://guard:p%40ss@broker.example:8884")
    assert (broker.host, broker.port, broker.encrypted, broker.user) == ("broker.example", 8884, True, "guard")
    assert broker.password == "p@ss"
    assert "p@ss" not in repr(broker)
    assert Broker.of("mqtt://localhost").port == 1883


@pytest.mark.parametrize(
    "url", ["http://secret@host", "mqtt://", "mqtt://u:secret@host:99999", "secret", "mqtt://h/secret"]
)
def test_a_wrong_brokers_url_is_refused_without_telling_its_password(url: str) -> None:
    with pytest.raises(ValueError, match="allowed") as caught:
        Broker.of(url)
    assert "secret" not in str(caught.value)
