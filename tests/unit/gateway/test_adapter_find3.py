"""The FIND3 adapter: a phone's post is a scan, a receiver's readings; mistakes are named, no address is told."""

import json
from typing import Any

import pytest
from conftest import ROOT
from hypothesis import given
from hypothesis import strategies as st
from refusals import refusals_name_a_field

from services.gateway.adapters.find3 import Find3, read_passive
from services.gateway.errors import RequestError
from services.gateway.phones.batch_check import Limits, check_batch

DATA = (ROOT / "tests/fixtures/find3_data.json").read_bytes()
PASSIVE = (ROOT / "tests/fixtures/find3_passive.json").read_bytes()
T = 1_767_225_600_897


def body(**changes: Any) -> bytes:
    return json.dumps({"d": "a", "f": "b", "t": T, "s": {"wifi": {"02:a7:00:00:00:01": -40}}} | changes).encode()


def refusal(payload: bytes) -> tuple[int, str, str]:
    with pytest.raises(RequestError) as caught:
        Find3().decode(payload, Limits())
    problem = caught.value.reply.detail[0]
    return caught.value.status, problem.field, f"{problem}"


def test_a_post_becomes_one_scan_per_kind_of_radio() -> None:
    found = Find3().decode(DATA, Limits())
    assert found.batch is not None
    wifi, ble = found.batch.radio
    assert (wifi.kind, ble.kind) == ("wifi", "ble")
    assert dict(zip(wifi.address, wifi.rssi, strict=True))["02:A7:00:00:00:01"] == -47
    assert wifi.t == found.batch.sent == T / 1000
    check_batch(found.batch, Limits())


def test_a_scanner_hears_transmitters_at_its_own_time() -> None:
    name, report = read_passive(PASSIVE, 100, 128)
    assert name == "Pi-Entrance"
    assert {(one.names, one.kind, one.rssi) for one in report.heard} >= {(("02:ee:00:00:00:01",), "wifi", -61.0)}
    assert {one.t for one in report.heard} == {T / 1000}
    assert len(report.heard) == 4


def test_other_kinds_of_sensors_are_counted_and_ignored() -> None:
    found = Find3().decode(body(s={"wifi": {"a": -40}, "light": {"lux": 7}, "x": 1}), Limits())
    assert found.ignored == {"sensor of no use here": 2}
    assert Find3().decode(body(s={"light": {"lux": 7}}), Limits()).batch is None


@pytest.mark.parametrize(
    ("payload", "status", "field"),
    [
        (b"\xff", 400, "body"),
        (b"[]", 422, "body"),
        (b'{"d": "a", "s": {}}', 422, "t"),
        (body(t=T / 1000), 422, "t"),
        (body(t=1e300), 422, "t"),
        (body(t="now"), 422, "t"),
        (body(s=[]), 422, "s"),
        (body(s={"wifi": 3}), 422, "s.wifi"),
        (body(s={"wifi": {"secret-address": "loud"}}), 422, "s.wifi[0]"),
        (body(s={"wifi": {"secret-address": 40}}), 422, "s.wifi[0]"),
        (body(s={"bluetooth": {"a": -40, "secret-address": None}}), 422, "s.bluetooth[1]"),
        (body(s={"wifi": {"secret-address" * 30: -40}}), 422, "s.wifi[0]"),
        (body(s={"wifi": {str(k): -40 for k in range(10_000)}}), 422, "s.wifi"),
    ],
)
def test_a_mistake_is_named_and_no_address_is_told(payload: bytes, status: int, field: str) -> None:
    found, name, text = refusal(payload)
    assert (found, name) == (status, field)
    assert "secret-address" not in text


def test_ten_thousand_readings_of_a_receiver_are_refused() -> None:
    with pytest.raises(RequestError, match=r"s\.wifi: too many readings"):
        read_passive(body(s={"wifi": {str(k): -40 for k in range(10_000)}}), 2000, 128)


@pytest.mark.parametrize("value", ["NaN", "Infinity", "-Infinity"])
def test_no_number_is_infinite(value: str) -> None:
    assert refusal(body().replace(b"-40", value.encode()))[:2] == (422, "s.wifi.02:a7:00:00:00:01")


anything = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(allow_nan=False), st.text(max_size=5)),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=5), inner, max_size=3)),
    max_leaves=6,
)


@given(st.fixed_dictionaries({"d": anything, "t": st.one_of(anything, st.just(T)), "s": anything}))
def test_whatever_comes_is_taken_or_refused_with_a_field(payload: dict[str, Any]) -> None:
    with refusals_name_a_field():
        found = Find3().decode(json.dumps(payload).encode(), Limits())
        assert found.batch is None or check_batch(found.batch, Limits()) is None
