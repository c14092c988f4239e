"""What was learned of a phone's headings is taken off them, also by a gateway started later, and forgotten with it."""

import math
import time
from pathlib import Path
from typing import Any

import msgspec
import pytest
from waiting import wait_until

from services.gateway.devices.storage import Registered, Walker
from services.gateway.phones.batch_check import Limits
from services.gateway.phones.phone import Phone
from services.gateway.phones.phone_book import PhoneBook
from services.gateway.protocol import Batch, RadioReadings
from services.gateway.reckoning.dead_reckoning import DeadReckoner
from services.learning.activation.kinds import as_configured
from shared.bus import Bus
from shared.keys import Keys
from shared.messages import HeadingModel, InertialColumns, MotionBatch, StrideModel
from shared.site import load_site

DEVICE = Registered("d-1", "hand")


SCAN = msgspec.json.encode(
    Batch(sent=100.0, seq=0, radio=[RadioReadings(t=100.0, address=["02:a7:00:00:00:01"], rssi=[-50.0])])
)


def walking(second: int) -> Batch:
    t = [100.0 + second + i / 50 for i in range(50)]
    columns: dict[str, Any] = {name: [0.0] * 50 for name in ("ax", "ay", "gx", "gy", "gz", "mx")}
    az = [9.81 + 3.0 * math.sin(2 * math.pi * 1.9 * (stamp - 100.0)) for stamp in t]
    return Batch(sent=t[-1], seq=second, imu=InertialColumns(t=t, az=az, my=[20.0] * 50, mz=[-43.0] * 50, **columns))


def steps_of(phone: Phone) -> list[MotionBatch]:
    reckoner = DeadReckoner(math.pi / 2)
    for second in range(10):
        phone.take(walking(second), 100.0 + second + 1.0, Limits(), reckoner)
    return [said for said in phone.outbox if isinstance(said, MotionBatch) and said.step_t]


@pytest.mark.parametrize("variance", [0.0, 0.3])
def test_headings_are_turned_back_and_never_surer_than_the_phone_itself_is(variance: float) -> None:
    plain, turned = Phone("d-1", {}, "hand"), Phone("d-1", {}, "hand")
    turned.turned = HeadingModel(t=0.0, device="d-1", version=1, bias=3.0, variance=variance)
    before, after = steps_of(plain), steps_of(turned)
    assert len(before) == len(after) >= 5
    for one, other in zip(before, after, strict=True):
        more = max(variance - one.heading_bias_variance, 0.0)
        assert other.heading_bias_variance == pytest.approx(one.heading_bias_variance + more)
        for name in ("heading", "other_heading"):
            for was, now in zip(getattr(one, name), getattr(other, name), strict=True):
                assert -math.pi <= now <= math.pi
                assert math.cos(was - 3.0 - now) == pytest.approx(1.0)
        assert other.heading_variance == pytest.approx([v + more for v in one.heading_variance])
        assert other.length == one.length


def test_a_model_taken_back_leaves_headings_as_the_phone_told_them() -> None:
    plain, taken_back = Phone("d-1", {}, "hand"), Phone("d-1", {}, "hand")
    model = as_configured("heading", "d-1", 0.0)
    assert isinstance(model, HeadingModel)
    taken_back.turned = model
    assert steps_of(plain) == steps_of(taken_back)


def test_a_gateway_that_starts_later_learns_of_it_and_forgets_it_with_the_device(
    zenoh_router: str, project: Path
) -> None:
    site = load_site(project / "deploy/sites/hall/site.yaml")
    keys = Keys(site.site)
    with Bus([zenoh_router]) as learning, Bus([zenoh_router]) as bus:
        publisher = learning.publisher(keys.heading_model(DEVICE.id), HeadingModel, cached=True)
        model = HeadingModel(t=1.0, device=DEVICE.id, version=3, bias=0.2, variance=0.03)
        publisher.publish(model)
        with PhoneBook(site, bus, Limits(), idle=10.0) as phones:
            wait_until(lambda: DEVICE.id in phones._turned, 10, "the model")
            phones.post(DEVICE, SCAN, time.time())
            assert phones._entries[DEVICE.id].phone.turned == model
            publisher.publish(msgspec.structs.replace(model, version=2, bias=1.0))  # older
            publisher.publish(msgspec.structs.replace(model, version=4, bias=0.0, variance=0.0))
            wait_until(lambda: phones._entries[DEVICE.id].phone.turned.bias == 0.0, 10, "the newest")  # type: ignore[union-attr]
            phones.forget(DEVICE.id)
            assert DEVICE.id not in phones._turned
            publisher.publish(msgspec.structs.replace(model, version=5))
            stride = StrideModel(t=1.0, device="d-2", version=1, slope=0.3, offset=0.1, scale_variance=0.01)
            learning.publisher(keys.stride_model("d-2"), StrideModel, cached=True).publish(stride)
            wait_until(lambda: "d-2" in phones._models, 10, "a message after it")
            assert DEVICE.id not in phones._turned


def test_a_stride_line_of_zeros_gives_trial_walks_their_word_back(zenoh_router: str, project: Path) -> None:
    site = load_site(project / "deploy/sites/hall/site.yaml")
    owner = Registered("d-1", "hand", Walker(1.0, 0.5, slope=0.35, offset=0.05, scale_variance=0.002))
    with Bus([zenoh_router]) as bus, PhoneBook(site, bus, Limits(), idle=10.0) as phones:
        phones.post(owner, SCAN, time.time())

        def slope() -> float:
            line = phones._entries["d-1"].phone.walk.line
            assert line is not None
            return float(line.slope)

        publisher = bus.publisher(Keys(site.site).stride_model("d-1"), StrideModel, cached=True)
        publisher.publish(StrideModel(t=1.0, device="d-1", version=1, slope=0.5, offset=0.1, scale_variance=0.01))
        wait_until(lambda: slope() == 0.5, 10, "the line learned")
        publisher.publish(StrideModel(t=2.0, device="d-1", version=2, slope=0.0, offset=0.0, scale_variance=0.0))
        wait_until(lambda: slope() == 0.35, 10, "the line of trial walks")
