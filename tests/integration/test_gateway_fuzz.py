"""Bad input against the running gateway: refused by name, counted, nothing stored, nothing on the bus."""

import gzip
import json
import random
import re
import sqlite3
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import httpx
import pytest
import schemathesis
from gateway_process import KEY, Listener, Phone, Running, problem, running_gateway
from hypothesis import HealthCheck, given, settings
from hypothesis.errors import Unsatisfiable
from schemathesis.generation import GenerationMode
from waiting import wait_until

EXAMPLES = 30
"""Of each operation, by its schema and against it."""
UNLIMITED = {"ATRIUM_ENROLMENTS_PER_MINUTE": "1e6", "ATRIUM_ENROLMENT_BURST": "1000000", "ATRIUM_BATCH_BURST": "100000"}


@pytest.fixture(scope="module")
def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with running_gateway(tmp_path_factory.mktemp("fuzz"), **UNLIMITED) as running:
        yield running


@pytest.fixture(scope="module")
def listener(gateway: Running) -> Iterator[Listener]:
    listening = Listener(gateway.endpoint)
    yield listening
    listening.bus.close()


def counted(gateway: Running) -> int:
    """How many requests the gateway says that it refused."""
    text = httpx.get(f"{gateway.health}/metrics").text
    return int(sum(float(n) for n in re.findall(r'^atrium_gateway_refused_total\{status="\d+"\} (\S+)$', text, re.M)))


def enrolled(gateway: Running) -> int:
    with closing(sqlite3.connect(gateway.database)) as database:
        count: int = database.execute("SELECT count(*) FROM gateway_devices").fetchone()[0]
        return count


def test_nothing_generated_from_the_gateways_own_page_breaks_it(gateway: Running, listener: Listener) -> None:
    page = schemathesis.openapi.from_dict(gateway.http.get("/openapi.json").json())
    seen: Counter[int] = Counter()
    refused_before, devices_before = counted(gateway), enrolled(gateway)
    scans_taken = new_devices = 0
    mine = Phone(gateway)
    new_devices += 1

    def send(case: Any, as_its_owner: bool) -> None:
        nonlocal scans_taken, new_devices
        if as_its_owner:
            names = {"device": mine.device, "token": mine.headers["Authorization"].partition(" ")[2], "key": KEY}
            case.path_parameters = {
                name: names.get(name, value) for name, value in (case.path_parameters or {}).items()
            }
            case.headers = {**(case.headers or {}), **mine.headers}
            if isinstance(case.body, dict) and "enrolment_key" in case.body:
                case.body["enrolment_key"] = KEY
        answer = case.call(base_url=str(gateway.http.base_url))
        seen[answer.status_code] += 1
        away = answer.status_code == 503 and "Retry-After" in answer.headers  # no history runs here
        assert answer.status_code < 500 or away, answer.text
        if answer.status_code >= 400:
            told = answer.json()
            assert told["status"] == answer.status_code
            assert told["detail"][0]["problem"]
            assert told["detail"][0]["field"] or answer.status_code in (429, 503)
        elif case.path.endswith("/batches") or "/sensor-logger" in case.path:
            scans_taken += answer.json()["accepted"]["scans"]
        elif case.path.endswith("/data"):
            scans_taken += 1
        elif answer.status_code == 201 and case.path == "/v1/devices":
            new_devices += 1

    for result in page.get_all_operations():
        operation = result.ok()
        if operation.method.upper() == "DELETE" and operation.path == "/v1/devices/{device}":
            continue  # it would take the consent of the phone that asks
        for mode in GenerationMode:

            @settings(max_examples=EXAMPLES, deadline=None, database=None, suppress_health_check=list(HealthCheck))
            @given(case=operation.as_strategy(generation_mode=mode))
            def fuzz(case: Any) -> None:
                send(case, as_its_owner=random.Random(repr(case.body)).random() < 0.8)

            try:
                fuzz()
            except Unsatisfiable:
                continue  # nothing can be wrong with a request that has no parts
    assert {200, 401, 422} <= set(seen)
    assert counted(gateway) - refused_before == sum(count for status, count in seen.items() if status >= 400)
    assert enrolled(gateway) - devices_before == new_devices
    assert len(listener.heard(mine.device)[0]) <= scans_taken
    fresh = Phone(gateway)
    assert fresh.post(fresh.batch(0)).status_code == 200
    wait_until(lambda: listener.heard(fresh.device)[0], 10, "a scan after all that")


def many_access_points(phone: Phone) -> Any:
    batch = phone.batch(0)
    address = [f"02:a7:00:00:{n // 256:02x}:{n % 256:02x}" for n in range(10_000)]
    return batch | {"radio": [{"t": batch["sent"], "address": address, "rssi": [-50.0] * 10_000}]}


def one_sample(phone: Phone) -> Any:
    batch = phone.batch(0)
    return batch | {"imu": {name: column[:1] for name, column in batch["imu"].items()}}


def scaled(name: str, factor: float) -> Callable[[Phone], Any]:
    def make(phone: Phone) -> Any:
        batch = phone.batch(0)
        columns = {column: [value * factor for value in batch["imu"][column]] for column in (f"{name}x", f"{name}y")}
        columns[f"{name}z"] = [value * factor for value in batch["imu"][f"{name}z"]]
        return batch | {"imu": batch["imu"] | columns}

    return make


def turning(phone: Phone) -> Any:
    batch = phone.batch(0)
    return batch | {"imu": batch["imu"] | {"gx": [30.0] * 50}}


def shifted(seconds: float) -> Callable[[Phone], Any]:
    def make(phone: Phone) -> Any:
        batch = phone.batch(0)
        return batch | {"imu": batch["imu"] | {"t": [t + seconds for t in batch["imu"]["t"]]}}

    return make


def in_milliseconds(phone: Phone) -> Any:
    batch = phone.batch(0)
    return batch | {"sent": batch["sent"] * 1000.0}


CASES: dict[str, tuple[Callable[[Phone], Any], dict[str, str], int, str]] = {
    "a hundred megabytes": (lambda _: b" " * 100_000_000, {}, 413, "body"),
    "a gzip bomb": (lambda _: gzip.compress(b" " * 100_000_000), {"Content-Encoding": "gzip"}, 413, "body"),
    "no gzip at all": (lambda _: b"not gzip", {"Content-Encoding": "gzip"}, 400, "body"),
    "not UTF-8": (lambda _: b'{"sent": 1, "seq": 0, "radio": [{"t": 1, "address": ["\xff"]}]}', {}, 400, "body"),
    "nested without end": (lambda _: b'{"imu":' * 100_000, {}, 400, "body"),
    "a name of signs that are none": (lambda _: b'{"sent": 1, "seq": 0, "\\ud800": NaN}', {}, 422, "?"),
    "10 000 access points": (many_access_points, {}, 422, "radio[0].address"),
    "one sample": (one_sample, {}, 422, "imu.t"),
    "acceleration in g": (scaled("a", 1 / 9.81), {}, 422, "imu.ax"),
    "rotation in degrees": (turning, {}, 422, "imu.gx"),
    "field in nT": (scaled("m", 1000.0), {}, 422, "imu.mx[0]"),
    "a negative time": (shifted(-1e10), {}, 422, "imu.t[0]"),
    "a time far ahead": (shifted(1e6), {}, 422, "imu.t[0]"),
    "milliseconds": (in_milliseconds, {}, 422, "sent"),
    "infinity": (
        lambda phone: json.dumps(phone.batch(0)).replace('"az": [9.81', '"az": [1e999').encode(),
        {},
        422,
        "imu.az[0]",
    ),
    "a negative number": (lambda phone: phone.batch(0) | {"seq": -1}, {}, 422, "seq"),
}


@pytest.mark.parametrize("case", CASES)
def test_what_no_phone_can_have_measured_is_refused_by_name_and_counted(
    gateway: Running, listener: Listener, case: str
) -> None:
    make, headers, status, field = CASES[case]
    phone = Phone(gateway)
    before = counted(gateway)
    answer = phone.post(make(phone), **headers)
    assert (answer.status_code, problem(answer)["field"]) == (status, field), answer.text
    assert counted(gateway) == before + 1
    assert phone.post(phone.batch(0)).json()["duplicate"] is False
    wait_until(lambda: listener.heard(phone.device)[0], 10, "the good batch after it")
    assert [scan.seq for scan in listener.heard(phone.device)[0]] == [0]


def test_replayed_and_swapped_numbers_are_taken_once_each(gateway: Running, listener: Listener) -> None:
    phone = Phone(gateway)
    answers = [phone.post(phone.batch(seq)).json()["duplicate"] for seq in (0, 2, 1, 2, 0, 3)]
    assert answers == [False, False, False, True, True, False]
    wait_until(lambda: len(listener.heard(phone.device)[0]) >= 4, 10, "four scans")
    assert [scan.seq for scan in listener.heard(phone.device)[0]] == [0, 1, 2, 3]


def test_another_devices_token_and_a_revoked_one_publish_nothing(gateway: Running, listener: Listener) -> None:
    phone, other = Phone(gateway), Phone(gateway)
    assert phone.post(phone.batch(0), **other.headers).status_code == 403
    made = phone.http.post(
        f"/v1/devices/{phone.device}/tokens", json={"scopes": ["post"]}, headers=phone.headers
    ).json()
    assert phone.http.delete(f"/v1/devices/{phone.device}/tokens/{made['id']}", headers=phone.headers).is_success
    answer = phone.post(phone.batch(0), Authorization=f"Bearer {made['token']}")
    assert (answer.status_code, problem(answer)["field"]) == (401, "Authorization")
    other.post(other.batch(0))
    wait_until(lambda: listener.heard(other.device)[0], 10, "a scan posted later")
    assert listener.heard(phone.device) == ([], [])
