"""Bad input: a typed refusal that names the field, and nothing of the batch used."""

import json
import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.gateway.errors import RequestError, read_json
from services.gateway.phones.batch_check import Limits
from services.gateway.phones.phone import Phone
from services.gateway.protocol import Batch
from services.gateway.reckoning.dead_reckoning import DeadReckoner

ADDRESSES = {"02:a7:00:00:00:01": "ap-1", "02:a7:00:00:00:02": "ap-2"}
LIMITS = Limits(samples=100, scans=5, readings=10)


def good(**changes: Any) -> dict[str, Any]:
    imu = {"t": [99.98, 99.99]} | {f"{kind}{axis}": [0.0, 0.1] for kind in "agm" for axis in "xyz"}
    radio = [{"t": 99.5, "kind": "wifi", "address": ["02:A7:00:00:00:01", "AA:BB"], "rssi": [-50, -60]}]
    return {"sent": 100.0, "seq": 0, "imu": imu, "radio": radio, **changes}


def with_imu(**columns: Any) -> dict[str, Any]:
    batch = good()
    batch["imu"] |= columns
    return batch


def with_scan(**fields: Any) -> dict[str, Any]:
    batch = good()
    batch["radio"][0] |= fields
    return batch


RECKONER = DeadReckoner(math.pi / 2)


def phone() -> Phone:
    return Phone("d-1", ADDRESSES, "hand")


def refusal(body: bytes, of: Phone | None = None) -> RequestError:
    with pytest.raises(RequestError) as caught:
        (of or phone()).take(read_json(body, Batch), 1e9, LIMITS, RECKONER)
    return caught.value


def g_units() -> dict[str, Any]:
    count = 60
    columns = {f"{kind}{axis}": [0.0] * count for kind in "agm" for axis in "xyz"}
    return with_imu(**columns | {"t": [99.0 + i / 100 for i in range(count)], "az": [1.0] * count})


@pytest.mark.parametrize(
    ("batch", "field"),
    [
        (good(imu=None, radio=[]), "body"),
        (with_imu(ax=[0.0, math.nan]), "imu.ax[1]"),
        (with_imu(gz=[math.inf, 0.0]), "imu.gz[0]"),
        (with_imu(ax=[0.0, None]), "imu.ax[1]"),
        (with_imu(ax=[0.0]), "imu.ax"),
        (with_imu(mz=[]), "imu.mz"),
        (with_imu(**{name: [1.0] for name in good()["imu"]} | {"t": [99.9]}), "imu.t"),
        (with_imu(t=[]), "imu.t"),
        (with_imu(**{name: [9.0] * 101 for name in good()["imu"]} | {"t": [99.0] * 101}), "imu.t"),
        (with_imu(t=[99.9, -5.0]), "imu.t[1]"),
        (with_imu(t=[99.6, 99.99]), "imu.t"),
        (with_imu(t=[99.9, 86_500.0]), "imu.t[1]"),
        (with_imu(ay=[500.0, 0.0]), "imu.ay[0]"),
        (with_imu(gx=[0.0, 180.0]), "imu.gx[1]"),
        (g_units(), "imu.ax"),
        (with_imu(ax="x"), "imu.ax"),
        (good(sent=math.nan), "sent"),
        (good(sent=-1.0), "sent"),
        (good(sent=1.7e12), "sent"),
        (good(sent="now"), "sent"),
        (good(seq=-1), "seq"),
        (good(seq=2**70), "seq"),
        (good(seq=1.5), "seq"),
        (good(echo={"replied": -1.0, "arrived": 1.0}), "echo.replied"),
        (good(echo={"replied": 1.0}), "echo.arrived"),
        ({"seq": 1}, "sent"),
        (with_scan(rssi=[-50]), "radio[0].rssi"),
        (with_scan(rssi=[-50, 100]), "radio[0].rssi[1]"),
        (with_scan(rssi=[-50, math.nan]), "radio[0].rssi[1]"),
        (with_scan(t=100_000.0), "radio[0].t"),
        (with_scan(kind="zigbee"), "radio[0].kind"),
        (with_scan(address=["", "b"]), "radio[0].address[0]"),
        (with_scan(address=["a" * 200, "b"]), "radio[0].address[0]"),
        (with_scan(address=["a"] * 10_000, rssi=[-50] * 10_000), "radio[0].address"),
        (good(radio=good()["radio"] * 6), "radio"),
    ],
)
def test_the_wrong_field_is_named_and_nothing_is_used(batch: dict[str, Any], field: str) -> None:
    to = phone()
    error = refusal(json.dumps(batch).encode(), to)
    assert error.status == 422
    assert [problem.field for problem in error.reply.detail] == [field]
    assert not to.outbox
    assert not to.take(read_json(json.dumps(good()).encode(), Batch), 1e9, LIMITS, RECKONER).duplicate


@pytest.mark.parametrize(
    "body", [b"", b"{", b"\xff\xfe{}", b"[" * 100_000, b'{"sent": 1, "seq": 0} x', b"null", b"[]", b'"text"', b"NaN"]
)
def test_what_is_no_json_object_is_refused(body: bytes) -> None:
    error = refusal(body)
    assert error.status in (400, 422)
    assert error.reply.detail[0].field == "body"


@pytest.mark.parametrize("number", ["1e999", "NaN", "-Infinity"])
def test_numbers_that_are_none_are_named_in_the_text_too(number: str) -> None:
    body = json.dumps(good()).replace("99.98", number).encode()
    assert refusal(body).reply.detail[0].field == "imu.t[0]"


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=4),
    max_leaves=8,
)


@settings(max_examples=300, deadline=None)
@given(data=st.data(), value=json_values)
def test_no_value_anywhere_breaks_anything(data: st.DataObject, value: Any) -> None:
    """Put any value at any place of a good batch: it is taken or refused with a 4xx, never anything else."""
    batch = good()
    places: list[Callable[[], None]] = [lambda key=key: batch.update({key: value}) for key in batch]
    places += [lambda key=key: batch["imu"].update({key: value}) for key in batch["imu"]]
    places += [lambda key=key: batch["imu"][key].__setitem__(0, value) for key in batch["imu"]]
    places += [lambda key=key: batch["radio"][0].update({key: value}) for key in batch["radio"][0]]
    data.draw(st.sampled_from(places))()
    to, status = phone(), 200
    try:
        to.take(read_json(json.dumps(batch).encode(), Batch), 1e9, LIMITS, RECKONER)
    except RequestError as error:
        status = error.status
    assert status in (200, 400, 422)
    assert status == 200 or not to.outbox
