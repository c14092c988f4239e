"""The Sensor Logger adapter: units and signs per platform, common rows, radio, and what is wrong named in its words."""

import gzip
import json
from typing import Any

import numpy as np
import pytest
from conftest import ROOT
from hypothesis import given
from hypothesis import strategies as st
from refusals import refusals_name_a_field

from services.gateway.adapters.adapter import Push
from services.gateway.adapters.sensor_logger import SensorLogger
from services.gateway.errors import RequestError
from services.gateway.phones.batch_check import Limits, check_batch

FIXTURES = ROOT / "tests/fixtures"
IPHONE = (FIXTURES / "sensor_logger_iphone.json").read_bytes()
START = 1_767_225_600_000_000_000


def session() -> list[bytes]:
    with gzip.open(FIXTURES / "sensor_logger_session.jsonl.gz") as lines:
        return lines.read().splitlines()


def decode(payload: Any, frame: Any = "android", limits: Limits | None = None) -> Push:
    body = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
    return SensorLogger(frame).decode(body, limits or Limits())


def entry(name: str, ms: float, x: Any = 0.0, y: Any = 0.0, z: Any = 9.8) -> dict[str, Any]:
    return {"name": name, "time": START + int(ms * 1_000_000), "values": {"x": x, "y": y, "z": z}}


def push(*entries: dict[str, Any]) -> dict[str, Any]:
    return {"messageId": 0, "sessionId": "s", "deviceId": "d", "payload": list(entries)}


def android(count: int = 60) -> list[dict[str, Any]]:
    rows = [entry("totalacceleration", 20 * k) for k in range(count)]
    return rows + [entry("gyroscope", 20 * k, 0, 0, 0) for k in range(count)]


def refusal(payload: Any, **settings: Any) -> str:
    with pytest.raises(RequestError) as caught:
        decode(payload, **settings)
    assert 400 <= caught.value.status < 500
    return caught.value.reply.detail[0].field


def test_every_push_of_a_real_walk_becomes_a_batch_that_the_gateway_takes() -> None:
    samples = 0
    for number, body in enumerate(session()):
        found = decode(body)
        assert found.batch is not None
        taken = check_batch(found.batch, Limits())
        assert taken is not None
        assert found.key[1] == str(number)
        assert found.ignored.keys() <= {"stamp told twice"}
        samples += len(taken.t)
    assert samples == 1259


def test_wifi_and_beacons_of_a_push_become_scans() -> None:
    scans = [scan for body in session() for scan in (decode(body).batch or pytest.fail("no batch")).radio]
    wifi = [scan for scan in scans if scan.kind == "wifi"]
    assert len(wifi) == 11
    assert all(len(scan.address) == 12 for scan in wifi)
    assert {len(scan.address) for scan in scans if scan.kind == "ble"}


def test_an_iphone_held_flat_feels_gravity_upwards_on_rows_of_the_accelerometer() -> None:
    found = decode(IPHONE, "ios")
    assert found.batch is not None
    assert found.batch.imu is not None
    imu = found.batch.imu
    assert np.mean(imu.az) == pytest.approx(9.80665, abs=0.15)
    assert imu.ax[0] == pytest.approx(0.02)
    # The gyroscope's stamps lie 4 ms later: 0.01 a sample, so 0.004 less, but for the first row, which has none before.
    assert imu.gz[50] == pytest.approx(0.50 - 0.004)
    assert imu.mz == pytest.approx([-43.0] * 120)
    assert found.batch.sent == imu.t[-1]
    assert found.ignored == {"sensor of no use here": 2, "entry without its values": 1}


def test_a_standardised_iphone_and_an_android_phone_need_no_turning_round() -> None:
    turned = json.loads(IPHONE)
    for one in turned["payload"]:
        if one["name"] in ("accelerometer", "gravity"):
            one["values"] = {axis: -value for axis, value in one["values"].items()}
    plain, ios = decode(turned).batch, decode(IPHONE, "ios").batch
    assert plain is not None
    assert ios is not None
    assert plain.imu == ios.imu


def test_total_acceleration_goes_before_the_sum_of_its_parts() -> None:
    parts = [entry(name, 20 * k, 1, 1, 1) for name in ("accelerometer", "gravity") for k in range(60)]
    found = decode(push(*android(), *parts))
    assert found.batch is not None
    assert found.batch.imu is not None
    assert found.batch.imu.az == [9.8] * 60


@pytest.mark.parametrize(("z", "expected"), [(-1.0, 9.80665), (9.8, 9.8)])
def test_uncalibrated_acceleration_in_g_is_an_iphones(z: float, expected: float) -> None:
    raw = [entry("accelerometeruncalibrated", 20 * k, 0, 0, z) for k in range(60)]
    found = decode(push(*raw, *[entry("gyroscope", 20 * k, 0, 0, 0) for k in range(60)]))
    assert found.batch is not None
    assert found.batch.imu is not None
    assert found.batch.imu.az == pytest.approx([expected] * 60)


def test_samples_out_of_order_and_told_twice_are_put_in_order() -> None:
    rows = android()
    found = decode(push(*rows[::-1], rows[0]))
    assert found.batch is not None
    assert found.batch.imu is not None
    assert np.all(np.diff(found.batch.imu.t) > 0)
    assert found.ignored == {"stamp told twice": 1}


def test_acceleration_far_from_any_rotation_is_left_out_and_counted() -> None:
    rows = [entry("totalacceleration", 20 * k) for k in range(100)]
    found = decode(push(*rows, *[entry("gyroscope", 20 * k, 0, 0, 0) for k in range(50)]))
    assert found.batch is not None
    assert found.batch.imu is not None
    assert len(found.batch.imu.t) == 55  # to 0.1 s beyond the last one
    assert found.ignored == {"acceleration without gyroscope": 45}


@pytest.mark.parametrize(
    "entries",
    [
        [],
        [entry("accelerometer", 20 * k) for k in range(60)],
        [entry("totalacceleration", 20 * k) for k in range(60)],
        [{"name": "location", "time": START, "values": {"latitude": 0.0}}, {"name": "battery", "time": START}],
    ],
    ids=["nothing", "no gravity", "no gyroscope", "other sensors"],
)
def test_a_push_with_nothing_of_use_is_no_error(entries: list[dict[str, Any]]) -> None:
    found = decode(push(*entries))
    assert found.batch is None
    assert sum(found.ignored.values()) == len(entries)


def test_fields_and_sensors_of_a_later_version_do_no_harm() -> None:
    later = push(*android(), {"name": "smell", "time": START, "values": {"roses": [1, {"x": None}]}})
    later["schema"] = {"version": 9}
    later["payload"][0]["accuracy"] = 3
    found = decode(later)
    assert found.batch is not None
    assert found.ignored == {"sensor of no use here": 1}


@pytest.mark.parametrize(
    ("stray", "reason"),
    [
        ({"name": "annotation", "time": "yesterday", "values": None}, "sensor of no use here"),
        ({"name": "location", "time": None, "values": [1, "a"]}, "sensor of no use here"),
        ({"name": 7}, "sensor of no use here"),
        ({"time": 0}, "sensor of no use here"),
        ({"name": "gyroscope", "time": START, "values": None}, "entry without its values"),
        ({"name": "wifi", "time": START, "values": "none"}, "entry without its values"),
    ],
)
def test_an_entry_that_is_not_used_may_hold_anything(stray: dict[str, Any], reason: str) -> None:
    found = decode(push(*android(), stray))
    assert found.batch is not None
    assert found.ignored == {reason: 1}


@pytest.mark.parametrize(
    ("bad", "field"),
    [
        (b"\xff\xfe{", "body"),
        (b"", "body"),
        (b'{"messageId": 0, "payload": 7}', "payload"),
        (b'{"payload": []}', "messageId"),
        (b'{"messageId": 0, "payload": [{"name": "gyroscope", "time": NaN}]}', "payload[0].time"),
        (push(entry("gyroscope", 0, x="1")), "payload[0].values.x"),
        (push(entry("gyroscope", 0, x=True)), "payload[0].values.x"),
        (push(entry("gyroscope", 0), entry("gyroscope", 20, y=[1])), "payload[1].values.y"),
        (push(entry("gyroscope", 0, z=51)), "payload[0].values.z"),
        (push(entry("gyroscope", 0, z=10**400)), "payload[0].values.z"),
        (push(entry("magnetometer", 0, z=-1e5)), "payload[0].values.z"),
        (push(entry("gyroscope", -2e12)), "payload[0].time"),
        (push({"name": "wifi", "time": START, "values": {"bssid": 3, "level": -40}}), "payload[0].values.bssid"),
        (push({"name": "wifi", "time": START, "values": {"bssid": "a", "level": "-40"}}), "payload[0].values.level"),
        (push({"name": "bluetooth", "time": START, "values": {"id": "a", "rssi": 900}}), "payload[0].values.rssi"),
        (push(*[one | {"values": {"x": 0, "y": 0, "z": 0.5}} for one in android()]), "payload"),
        (push(*[one | {"values": {"x": 0, "y": 20, "z": 9.8}} for one in android()]), "payload"),
        (push(*android(), entry("totalacceleration", -4e6), entry("gyroscope", -4e6)), "payload"),
    ],
)
def test_what_is_wrong_is_named_in_the_apps_words(bad: Any, field: str) -> None:
    assert refusal(bad) == field


def test_ten_thousand_access_points_in_a_push_are_refused() -> None:
    wifi = [{"name": "wifi", "time": START, "values": {"bssid": f"{k}", "level": -60}} for k in range(10_000)]
    assert refusal(push(*wifi)) == "payload"


def test_more_samples_than_a_batch_may_hold_are_refused() -> None:
    assert refusal(push(*android(60)), limits=Limits(samples=50)) == "payload"


def test_a_wifi_entry_of_another_day_does_not_spoil_the_push() -> None:
    stale = {"name": "wifi", "time": START - 10**14, "values": {"bssid": "02:a7:00:00:00:01", "level": -40}}
    found = decode(push(*android(), stale))
    assert found.batch is not None
    assert found.batch.radio == []
    assert found.ignored == {"radio of another time": 1}


number = st.one_of(st.integers(), st.floats(), st.none(), st.text(max_size=3), st.booleans(), st.just(9.8))
names = st.sampled_from(["totalacceleration", "accelerometer", "gravity", "gyroscope", "wifi", "bluetooth", "x"])
entries = st.fixed_dictionaries(
    {"name": names, "time": st.one_of(number, st.integers(START, START + 10**9))},
    optional={
        "values": st.dictionaries(st.sampled_from(["x", "y", "z", "bssid", "level", "id", "rssi"]), number, max_size=7)
    },
)


@given(st.lists(entries, max_size=8))
def test_whatever_comes_is_taken_or_refused_with_a_field(rows: list[dict[str, Any]]) -> None:
    body = json.dumps({"messageId": 1, "payload": rows}).encode()
    with refusals_name_a_field():
        found = SensorLogger().decode(body, Limits())
        if found.batch is not None:
            check_batch(found.batch, Limits())


@given(st.binary(max_size=64))
def test_bytes_that_are_no_push_are_refused(body: bytes) -> None:
    with pytest.raises(RequestError):
        SensorLogger().decode(body, Limits())
